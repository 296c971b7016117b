"""Estimated trajectories against a reference."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.streams import ReferenceStream
from polemap.drivelog.tum import read_tum
from polemap.evaluation.errors import accuracy
from polemap.localize.replay import Run
from polemap.vehicle.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Errors of a trajectory against a reference, over all its poses that have one.

    `lateral` is across and `longitudinal` along the reference's heading. `nees_mean` is the mean
    normalized squared error per degree of freedom: 1 where the stated covariance is right; None
    where the trajectory states none.
    """

    poses: int
    poses_without_reference: int
    lateral_rmse_m: float
    longitudinal_rmse_m: float
    position_rmse_m: float
    position_median_m: float
    position_p95_m: float
    position_max_m: float
    yaw_rmse_rad: float
    nees_mean: float | None


def evaluate(
    estimate: Run | Trajectory | str | Path,
    reference: Drive | Trajectory | str | Path,
    *,
    of: Literal["kf", "pf"] = "kf",
) -> Accuracy:
    """Hold an estimated trajectory against a reference.

    Args:
        estimate: a run of `replay`, a folder of `polemap localize`, a TUM file, or a trajectory.
        reference: a drive with reference poses, the path of one, a TUM file, or a trajectory.
        of: which trajectory of a run: the output filter's ("kf") or the particle filter's ("pf").

    Raises:
        InputError: a file is missing or damaged, the reference has no poses, or none of them lies
            within the time of the estimate.
    """
    true = _reference(reference)
    figures = accuracy(_estimate(estimate, of), true)
    if not figures["poses"]:
        raise InputError(
            f"no pose of the estimate lies within the reference's time "
            f"({true.stamp_s[0]:.3f} to {true.stamp_s[-1]:.3f} s): are both of the same drive?"
        )
    return Accuracy(
        poses=int(figures["poses"]),
        poses_without_reference=int(figures["poses_without_reference"]),
        lateral_rmse_m=figures["lateral_rmse_m"],
        longitudinal_rmse_m=figures["longitudinal_rmse_m"],
        position_rmse_m=figures["position_rmse_m"],
        position_median_m=figures["position_median_m"],
        position_p95_m=figures["position_p95_m"],
        position_max_m=figures["position_max_m"],
        yaw_rmse_rad=figures["yaw_rmse_rad"],
        nees_mean=figures.get("nees_mean"),
    )


def _estimate(estimate: Run | Trajectory | str | Path, of: Literal["kf", "pf"]) -> Trajectory:
    if isinstance(estimate, Run):
        return estimate.kf if of == "kf" else estimate.pf
    if isinstance(estimate, str | Path):
        path = Path(estimate)
        if path.is_dir():
            path = path / f"{of}.tum"
            runs = sorted(path.parent.glob(f"*/{of}.tum"))
            if runs and not path.is_file():
                raise InputError(
                    f"{path.parent}: a folder of runs; evaluate one of them, such as "
                    f"{runs[0].parent}"
                )
        estimate = read_tum(path)
    return estimate


def _reference(reference: Drive | Trajectory | str | Path) -> ReferenceStream:
    if isinstance(reference, str | Path):
        path = Path(reference)
        reference = read_tum(path) if path.suffix == ".tum" else open_drive(path)
    if isinstance(reference, Trajectory):
        unknown = np.full(len(reference), np.nan)
        return ReferenceStream(reference.stamp_s, reference.poses, unknown)
    if reference.reference is None or not len(reference.reference):
        raise InputError(f"drive {reference.name}: it has no reference poses to evaluate against")
    return reference.reference
