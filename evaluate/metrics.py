"""Errors of a trajectory against a reference, and the summaries that metrics.json holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.streams import ReferenceStream
from polemap.vehicle.kalman import chi_square_quantile
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]


def pose_errors(estimated: Floats, true: Floats) -> Floats:
    """Errors `(n, 3)`: along and across the true heading, and yaw; in the true vehicle frame.

    Args:
        estimated, true: `(n, 3)` east, north, yaw.
    """
    difference = np.asarray(estimated, dtype=np.float64) - true
    c, s = np.cos(true[:, 2]), np.sin(true[:, 2])
    along = c * difference[:, 0] + s * difference[:, 1]
    across = -s * difference[:, 0] + c * difference[:, 1]
    return np.stack([along, across, wrap_angle(difference[:, 2])], axis=1)


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


def accuracy(
    stamps_s: Floats, poses: Floats, covariance: Floats | None, reference: ReferenceStream
) -> dict[str, float]:
    """The accuracy figures of metrics.json for one trajectory.

    `nees_mean` is per degree of freedom (1 is consistent), the reference taken as true; it is
    left out without covariances. All figures are over the poses within the reference's time.
    """
    true = reference.at(stamps_s)
    known = np.isfinite(true).all(axis=1)
    result = {"poses": float(known.sum()), "poses_without_reference": float((~known).sum())}
    if not known.any():
        return result
    error = pose_errors(poses[known], true[known])
    distance = np.hypot(error[:, 0], error[:, 1])
    result |= {
        "lateral_rmse_m": _rms(error[:, 1]),
        "lateral_median_m": float(np.median(np.abs(error[:, 1]))),
        "lateral_p95_m": float(np.percentile(np.abs(error[:, 1]), 95)),
        "longitudinal_rmse_m": _rms(error[:, 0]),
        "position_rmse_m": _rms(distance),
        "position_mean_m": float(distance.mean()),
        "position_median_m": float(np.median(distance)),
        "position_p95_m": float(np.percentile(distance, 95)),
        "position_max_m": float(distance.max()),
        "yaw_rmse_rad": _rms(error[:, 2]),
        "yaw_p95_rad": float(np.percentile(np.abs(error[:, 2]), 95)),
    }
    if covariance is not None:
        values = nees(poses[known], true[known], covariance[known])
        if np.isfinite(values).any():
            result["nees_mean"] = float(np.nanmean(values) / 3.0)
            result["nees_median"] = float(np.nanmedian(values) / chi_square_quantile(0.5, 3))
    sd = reference.sd_at(stamps_s[known])
    if np.isfinite(sd).any():
        result["reference_sd_m"] = float(np.nanmean(sd))
    return result


def smoothness(stamps_s: Floats, poses: Floats) -> dict[str, float]:
    """How smooth a trajectory is: rms of its third difference per axis of the vehicle.

    Given as it stands (metres between neighbours) and as jerk, divided by the step cubed.
    """
    if len(poses) < 4:
        return {}
    step = float(np.median(np.diff(stamps_s)))
    even = np.abs(np.diff(stamps_s) - step) < 0.1 * step
    third = np.diff(poses[:, :2], n=3, axis=0)
    whole = even[:-2] & even[1:-1] & even[2:]
    heading = poses[1:-2, 2]
    lateral = -np.sin(heading) * third[:, 0] + np.cos(heading) * third[:, 1]
    along = np.cos(heading) * third[:, 0] + np.sin(heading) * third[:, 1]
    if not whole.any():
        return {}
    return {
        "lateral_third_difference_m": _rms(lateral[whole]),
        "longitudinal_third_difference_m": _rms(along[whole]),
        "lateral_jerk_rms_mps3": _rms(lateral[whole]) / step**3,
    }


def timing_summary(timings_s: Mapping[str, Sequence[float]]) -> dict[str, dict[str, float]]:
    """Median, p95 and p99 in milliseconds per stage, with the number of calls."""
    return {
        stage: {
            "median": float(np.median(values)) * 1e3,
            "p95": float(np.percentile(values, 95)) * 1e3,
            "p99": float(np.percentile(values, 99)) * 1e3,
            "calls": len(values),
        }
        for stage, values in timings_s.items()
        if len(values)
    }


def spread(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Mean, standard deviation, least and most of every number that the runs share, as a tree.

    Numbers that are not finite are left out of their statistics; text and lists are not averaged.
    """
    result: dict[str, Any] = {}
    for key in runs[0] if runs else ():
        values = [run[key] for run in runs if key in run]
        if all(isinstance(value, Mapping) for value in values):
            result[key] = spread(values)
        elif all(
            isinstance(value, int | float) and not isinstance(value, bool) for value in values
        ):
            finite = np.array([value for value in values if isfinite(value)])
            if len(finite):
                sd = float(finite.std(ddof=1)) if len(finite) > 1 else 0.0
                result[key] = {
                    "mean": float(finite.mean()),
                    "sd": sd,
                    "min": float(finite.min()),
                    "max": float(finite.max()),
                    "runs": len(finite),
                }
    return result


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
