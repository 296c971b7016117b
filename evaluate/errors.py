"""Errors of poses against a reference: along and across the direction of travel, NEES, figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.streams import ReferenceStream
from polemap.vehicle.kalman import chi_square_quantile
from polemap.vehicle.pose import rotate_back, wrap_angle
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]

ACCURACY_KEYS = (
    "lateral_rmse_m", "lateral_median_m", "lateral_p95_m", "longitudinal_rmse_m",
    "position_rmse_m", "position_mean_m", "position_median_m", "position_p95_m", "position_max_m",
    "yaw_rmse_rad", "yaw_p95_rad",
)  # fmt: skip
"""What `accuracy` keeps of a summary."""


class TimedPoses(Protocol):
    """What has poses at stamps: a trajectory or a reference stream."""

    def at(self, stamps_s: Floats) -> Floats:
        """Poses `(m, 3)` at the stamps `(m,)`; NaN where there are none."""
        ...


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

    def split(self, stamp_s: float) -> tuple[Errors, Errors]:
        """The errors before `stamp_s`, and those from it on."""
        late = self.stamp_s >= stamp_s
        before, after = (
            Errors(self.stamp_s[k], self.lateral_m[k], self.longitudinal_m[k], self.yaw_rad[k])
            for k in (~late, late)
        )
        return before, after


def pose_errors(estimated: Floats, true: Floats) -> Floats:
    """Errors `(n, 3)`: along and across the true heading, and yaw; in the true vehicle frame.

    Args:
        estimated, true: `(n, 3)` east, north, yaw.
    """
    difference = np.asarray(estimated, dtype=np.float64) - true
    along_across = rotate_back(difference[:, :2], true[:, 2])
    return np.column_stack([along_across, wrap_angle(difference[:, 2])])


def nees(estimated: Floats, true: Floats, covariance: Floats) -> Floats:
    """Normalized squared errors `(n,)` of poses `(n, 3)` with covariances `(n, 3, 3)`.

    NaN where a covariance is not positive definite.
    """
    error = np.asarray(estimated, dtype=np.float64) - true
    error[:, 2] = wrap_angle(error[:, 2])
    result = np.full(len(error), np.nan)
    rows = np.flatnonzero(np.isfinite(error).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2)))
    rows = rows[np.linalg.eigvalsh(covariance[rows])[:, 0] > 0.0]
    solved = np.linalg.solve(covariance[rows], error[rows][..., None])[..., 0]
    result[rows] = (error[rows] * solved).sum(axis=1)
    return result


def errors_against(estimate: Trajectory, reference: TimedPoses) -> Errors:
    """Errors of `estimate` at its own stamps; stamps without a reference are left out."""
    truth = reference.at(estimate.stamp_s)
    known = np.isfinite(truth[:, 0])
    along, across, yaw = pose_errors(estimate.poses[known], truth[known]).T
    return Errors(estimate.stamp_s[known], across, along, yaw)


def first_on_poles_s(stamp_s: Floats, pose_age_s: Floats) -> float | None:
    """The first stamp at which a pose on poles had reached the output; None where none has.

    Errors of the output count from here on: before, it shows how good a start by GNSS is.

    Args:
        stamp_s: `(n,)` of the output.
        pose_age_s: `(n,)` age of the last pose on poles, not finite before the first.
    """
    rows = np.flatnonzero(np.isfinite(pose_age_s))
    return float(stamp_s[rows[0]]) if len(rows) else None


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


def accuracy(estimate: Trajectory, reference: ReferenceStream) -> dict[str, float]:
    """The accuracy figures of a run's metrics.json for one trajectory.

    `nees_mean` is per degree of freedom (1 is consistent), the reference taken as true; it is
    left out without covariances. All figures are over the poses within the reference's time.
    """
    true = reference.at(estimate.stamp_s)
    known = np.asarray(np.isfinite(true).all(axis=1))
    result = {"poses": float(known.sum()), "poses_without_reference": float((~known).sum())}
    if not known.any():
        return result
    kept = estimate.rows(known)
    errors = errors_against(kept, reference)
    figures = summary(errors)
    figures["position_mean_m"] = float(errors.position_m.mean())
    figures["position_max_m"] = float(errors.position_m.max())
    result |= {key: figures[key] for key in ACCURACY_KEYS}
    if kept.covariance is not None:
        values = nees(kept.poses, true[known], kept.covariance)
        if np.isfinite(values).any():
            result["nees_mean"] = float(np.nanmean(values) / 3.0)
            result["nees_median"] = float(np.nanmedian(values) / chi_square_quantile(0.5, 3))
    sd = reference.sd_at(kept.stamp_s)
    if np.isfinite(sd).any():
        result["reference_sd_m"] = float(np.nanmean(sd))
    return result
