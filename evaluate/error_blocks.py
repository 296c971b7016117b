"""Errors of several recordings together, and in blocks of time for the bootstrap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from polemap.evaluation.bootstrap import Blocks
from polemap.evaluation.errors import Errors, summary

Floats = NDArray[np.float64]

BLOCK_S = 5.0


def settled_summary(parts: Sequence[Errors], settled_s: Sequence[float]) -> dict[str, float]:
    """The summary over all recordings, and `settled_...` for what follows each one's start-up."""
    settled = [one.after(stamp_s) for one, stamp_s in zip(parts, settled_s, strict=True)]
    later = summary(_joined(settled))
    return {
        **summary(_joined(parts)),
        **{f"settled_{key}": value for key, value in later.items() if "_rmse_" in key},
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
