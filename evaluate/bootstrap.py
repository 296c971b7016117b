"""Paired bootstrap of the difference between two systems on the same stretch of road, and the
blocks of errors that it draws.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.evaluation.errors import Errors, summary

Floats = NDArray[np.float64]

DRAWS = 2000


@dataclass(frozen=True, slots=True)
class Blocks:
    """Squared errors of one system, summed over blocks of road or time.

    Attributes:
        squares: `(runs, blocks)` sums of squares.
        weights: `(runs, blocks)` what they are divided by (values, or degrees of freedom).
    """

    squares: Floats
    weights: Floats

    def root_mean(self) -> float:
        """The mean over the runs of the root of the mean square."""
        with np.errstate(invalid="ignore", divide="ignore"):
            per_run = np.sqrt(self.squares.sum(axis=1) / self.weights.sum(axis=1))
        return float(np.mean(per_run))


@dataclass(frozen=True, slots=True)
class Difference:
    """`a - b` with its 95 % interval; `blocks` says how many pieces were resampled."""

    difference: float
    low: float
    high: float
    blocks: int

    @property
    def clear(self) -> bool:
        """Whether the interval lies on one side of zero."""
        return self.low > 0.0 or self.high < 0.0


def paired_difference(
    a: Blocks, b: Blocks, rng: np.random.Generator, draws: int = DRAWS
) -> Difference | None:
    """Difference of the two root means; None where fewer than four blocks have both.

    The blocks of road are drawn with replacement, the same for both systems, and so are the runs
    where both have the same number of them (same seeds); a system with one run is compared with
    every run of the other.
    """
    both = (a.weights.sum(axis=0) > 0) & (b.weights.sum(axis=0) > 0)
    count = int(both.sum())
    if count < 4:
        return None
    a = Blocks(a.squares[:, both], a.weights[:, both])
    b = Blocks(b.squares[:, both], b.weights[:, both])
    rows_a, rows_b = len(a.squares), len(b.squares)
    paired = rows_a == rows_b
    picks = rng.multinomial(count, np.full(count, 1.0 / count), size=draws).astype(np.float64)
    run_weights_a = _run_weights(rows_a, draws, rng)
    run_weights_b = run_weights_a if paired else _run_weights(rows_b, draws, rng)
    drawn = _resampled(a, picks, run_weights_a) - _resampled(b, picks, run_weights_b)
    low, high = np.nanquantile(drawn, [0.025, 0.975])
    return Difference(a.root_mean() - b.root_mean(), float(low), float(high), count)


def _run_weights(runs: int, draws: int, rng: np.random.Generator) -> Floats:
    return np.asarray(rng.multinomial(runs, np.full(runs, 1.0 / runs), size=draws) / runs)


def _resampled(blocks: Blocks, picks: Floats, run_weights: Floats) -> Floats:
    """Root means `(draws,)` for the picked blocks, averaged over the picked runs."""
    with np.errstate(invalid="ignore", divide="ignore"):
        per_run = np.sqrt((picks @ blocks.squares.T) / (picks @ blocks.weights.T))
    known = np.isfinite(per_run)
    weight = np.where(known, run_weights, 0.0)
    total = weight.sum(axis=1)
    summed = np.where(known, per_run, 0.0) * weight
    missing = np.full(len(total), np.nan)
    return np.asarray(np.divide(summed.sum(axis=1), total, out=missing, where=total > 0))


BLOCK_S = 5.0


def summary_and_start(parts: Sequence[Errors], starts: Sequence[Errors]) -> dict[str, float]:
    """The summary over all recordings, and `start_...` of what came before it counted."""
    before = summary(_joined(starts))
    return {
        **summary(_joined(parts)),
        **{f"start_{key}": v for key, v in before.items() if "_rmse_" in key or key == "poses"},
    }


def _joined(parts: Sequence[Errors]) -> Errors:
    names = ("stamp_s", "lateral_m", "longitudinal_m", "yaw_rad")
    return Errors(*(np.concatenate([getattr(one, name) for one in parts]) for name in names))


def all_blocks(
    per_run: Sequence[Sequence[Errors]], spans_s: Sequence[tuple[float, float]]
) -> dict[str, Blocks]:
    """`error_blocks` of every kind, recording after recording; empty without runs.

    Args:
        per_run: the errors of each recording, run by run.
        spans_s: first and last stamp of each recording.
    """
    if not per_run:
        return {}
    result = {}
    for kind in ("lateral_m", "longitudinal_m", "position_m", "yaw_rad"):
        parts = [
            error_blocks([run[number] for run in per_run], kind, *span)
            for number, span in enumerate(spans_s)
        ]
        result[kind] = Blocks(
            np.concatenate([p.squares for p in parts], axis=1),
            np.concatenate([p.weights for p in parts], axis=1),
        )
    return result


def error_blocks(
    per_run: list[Errors], kind: str, start_s: float, end_s: float, block_s: float = BLOCK_S
) -> Blocks:
    """Squares of one kind of error over blocks of time, for the paired bootstrap."""
    count = max(int(np.ceil((end_s - start_s) / block_s)), 1)
    squares, weights = np.zeros((len(per_run), count)), np.zeros((len(per_run), count))
    for row, errors in enumerate(per_run):
        block = np.clip(((errors.stamp_s - start_s) / block_s).astype(np.int64), 0, count - 1)
        values = getattr(errors, kind)
        squares[row] = np.bincount(block, values**2, minlength=count)
        weights[row] = np.bincount(block, minlength=count)
    return Blocks(squares, weights)
