"""Errors against a reference: in the direction of travel and across it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tools.report.bootstrap import Blocks
from tools.report.trajectory import Trajectory
from vehicle.pose import wrap_angle

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
