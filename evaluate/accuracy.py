"""Errors against a reference: in the direction of travel and across it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.evaluation.bootstrap import Blocks
from polemap.evaluation.trajectory import Trajectory
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]

BLOCK_S = 5.0


@dataclass(frozen=True, slots=True)
class Errors:
    """Estimate minus reference at the stamps of the estimate, where the reference exists.

    `lateral_m` to the left and `longitudinal_m` ahead of the reference's heading; `(n,)` each.
    """

    stamp_s: Floats
    lateral_m: Floats
    longitudinal_m: Floats
    yaw_rad: Floats

    @property
    def position_m(self) -> Floats:
        """Distance to the reference, `(n,)`."""
        return np.asarray(np.hypot(self.lateral_m, self.longitudinal_m))

    def after(self, stamp_s: float) -> Errors:
        """The errors from `stamp_s` on."""
        keep = self.stamp_s >= stamp_s
        return Errors(
            self.stamp_s[keep], self.lateral_m[keep], self.longitudinal_m[keep], self.yaw_rad[keep]
        )


def errors_against(estimate: Trajectory, reference: Trajectory) -> Errors:
    """Errors of `estimate` at its own stamps; stamps without a reference are left out."""
    truth = reference.at(estimate.stamp_s)
    known = np.isfinite(truth[:, 0])
    truth, poses = truth[known], estimate.poses[known]
    offset = poses[:, :2] - truth[:, :2]
    cos, sin = np.cos(truth[:, 2]), np.sin(truth[:, 2])
    return Errors(
        estimate.stamp_s[known],
        -sin * offset[:, 0] + cos * offset[:, 1],
        cos * offset[:, 0] + sin * offset[:, 1],
        np.asarray(wrap_angle(poses[:, 2] - truth[:, 2])),
    )


def summary(errors: Errors) -> dict[str, float]:
    """Root mean square, median and 95 % quantile of every kind of error; empty without any."""
    if len(errors.stamp_s) == 0:
        return {}
    result: dict[str, float] = {"poses": float(len(errors.stamp_s))}
    for name, values, unit in (
        ("lateral", errors.lateral_m, "m"),
        ("longitudinal", errors.longitudinal_m, "m"),
        ("position", errors.position_m, "m"),
        ("yaw", errors.yaw_rad, "rad"),
    ):
        size = np.abs(values)
        result[f"{name}_rmse_{unit}"] = float(np.sqrt(np.mean(values**2)))
        result[f"{name}_median_{unit}"] = float(np.median(size))
        result[f"{name}_p95_{unit}"] = float(np.quantile(size, 0.95))
    result["lateral_mean_m"] = float(np.mean(errors.lateral_m))
    result["longitudinal_mean_m"] = float(np.mean(errors.longitudinal_m))
    return result


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
