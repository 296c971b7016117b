"""Maps without reference poses: detect, solve, write the poses, build with them."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import typer

from polemap.build.build_map import BuiltMap, build_map, unique_names
from polemap.build.slam.motion import MotionNoise
from polemap.build.slam.report import sentences
from polemap.build.slam.slam import SlamResult, solve_slam
from polemap.drivelog.atomic import atomic_folder
from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.odometry_choice import resolve
from polemap.drivelog.tum import shortest, tum_text
from polemap.extras import check_installed
from polemap.localize.config import LocalizeConfig
from polemap.settings import Settings
from polemap.tools.map_worker import scan
from polemap.tools.progress import progress

# of the odometry's noise figures, which are stated for it
_STEP_S = 0.02
_COLUMNS = (
    "stamp_s,east_m,north_m,yaw_rad,sd_m,var_east_m2,cov_east_north_m2,var_north_m2,var_yaw_rad2"
)
KIND = "poses"
_FIGURES = "slam.json"


@dataclass(frozen=True, slots=True)
class BuiltWithoutReference:
    """A map, the drives with their solved poses as reference, and what was found out."""

    built: BuiltMap
    drives: tuple[Drive, ...]
    result: SlamResult


def lacks_reference(drive: Drive) -> bool:
    """Whether a map can be built from a drive only by solving for its poses."""
    return drive.reference is None or not len(drive.reference)


def check_slam(drives: Sequence[Drive], odometry: str, *, asked: bool) -> None:
    """Refuse what cannot be done before poles are detected; say so where it was not asked for.

    Args:
        odometry: the choice; where workers open the drives, these here have what was recorded.

    Raises:
        InputError: odometry made from the reference.
    """
    lacking = next((drive.name for drive in drives if lacks_reference(drive)), None)
    if lacking is not None and not asked:
        typer.echo(f"note: drive {lacking} has no reference poses: they are estimated (--slam)")
    for drive in drives:
        if drive.odometry_is_derived and resolve(drive, odometry) == "derived":
            raise InputError(
                f"drive {drive.name}: its odometry was made from its reference, which --slam does "
                "without; choose --odometry camera"
            )


def build_without_reference(
    drives: Sequence[Drive], settings: Settings, *, align: bool
) -> BuiltWithoutReference:
    """Detect poles, solve for the poses, and build the map with them.

    Raises:
        MissingExtraError: gtsam is not installed.
        InputError: see `solve_slam`.
    """
    check_installed("gtsam")
    names = unique_names(drives)
    total = sum(len(d.frame_stamps_s) if d.has_frames else len(d.scans) for d in drives)
    with progress(total, "detecting poles") as advance:
        scans = [scan(drive, settings, advance) for drive in drives]
    with progress(None, "solving poses and poles"):
        result = solve_slam(
            list(zip(names, drives, strict=True)),
            scans,
            settings.polemap.mapping,
            settings.polemap.slam,
            motion_noise(settings.localize),
            drives[0].frame,
        )
    solved = tuple(
        replace(drive, frame=result.frame, reference=reference)
        for drive, reference in zip(drives, result.references, strict=True)
    )
    seen = dict(zip(map(id, solved), scans, strict=True))

    def scans_of(drive: Drive) -> Sequence[Detections]:
        return seen[id(drive)]

    built = build_map(solved, settings.polemap, scans_of, frame=result.frame, align=align)
    built = replace(built, pole_map=result.with_precision(built.pole_map))
    return BuiltWithoutReference(built, solved, result)


def motion_noise(config: LocalizeConfig) -> MotionNoise:
    """The localizer's noise of odometry as densities."""
    root = _STEP_S**0.5
    return MotionNoise(
        along_m_per_sqrt_s=config.alpha1_speed_mps * root,
        along_share_sqrt_s=config.alpha1_relative * root,
        yaw_rad_per_sqrt_s=config.alpha2_yaw_rate_radps * root,
        turn_share_sqrt_s=config.alpha3_rotation_s / root,
        turn_most_rad_per_sqrt_s=config.alpha4_rotation_rad / root,
        left_m_per_sqrt_m=config.alpha5_slip_m_per_sqrt_m,
    )


def write_poses(folder: Path, names: Sequence[str], result: SlamResult) -> None:
    """Write `NAME.tum` and `NAME.csv` of every drive, and the figures as `slam.json`.

    The CSV is a reference.csv: `sd_m` is what the pose is known to against the poles beside it;
    the further columns are the covariance to the earth.
    """
    with atomic_folder(folder, KIND) as part:
        for name, reference, trajectory in zip(
            names, result.references, result.trajectories, strict=True
        ):
            stem = file_stem(name)
            (part / f"{stem}.tum").write_text(tum_text(trajectory), encoding="utf-8")
            covariance = trajectory.covariance
            assert covariance is not None
            table = np.column_stack(
                [
                    reference.stamp_s, reference.poses, reference.sd_m, covariance[:, 0, 0],
                    covariance[:, 0, 1], covariance[:, 1, 1], covariance[:, 2, 2],
                ]
            )  # fmt: skip
            lines = (",".join(map(shortest, row)) for row in table.tolist())
            text = "\n".join([_COLUMNS, *lines]) + "\n"
            (part / f"{stem}.csv").write_text(text, encoding="utf-8")
        figures = json.dumps(result.summary.as_dict(), indent=2, allow_nan=False)
        (part / _FIGURES).write_text(figures + "\n", encoding="utf-8")


def file_stem(name: str) -> str:
    """A drive's name as a file's: no separators."""
    return re.sub(r"[^\w.() -]", "_", name).strip(". ") or "drive"


def slam_sentences(result: SlamResult) -> tuple[str, ...]:
    """What to say of it on a terminal."""
    return sentences(result.summary)
