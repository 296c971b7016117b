"""`polemap odometry`: the motion of a drive from its stereo camera alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from polemap.drivelog.atomic import atomic_file, check_files
from polemap.drivelog.camera_motion import CameraTrack, PlanarMotion, track_camera
from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.results.targets import check_own_kind
from polemap.drivelog.tum import spatial_tum_text
from polemap.settings import load_settings
from polemap.tools.findings import require_plausible
from polemap.tools.option_types import (
    ConfigOption,
    ForceOption,
    LapOption,
    SetOption,
    TopicsOption,
)
from polemap.tools.plausible import find
from polemap.tools.progress import progress

_DIGITS = {"stamp_s": 6, "arrival_s": 6}


def command(
    drive: Annotated[Path, typer.Argument(help="Drive with stereo images.")],
    out: Annotated[Path, typer.Option("--out", help="Poses of the left camera, NAME.tum.")],
    table: Annotated[
        Path | None, typer.Option("--csv", help="Speed and yaw rate, as odometry.csv of a drive.")
    ] = None,
    lap: LapOption = None,
    topics: TopicsOption = None,
    force: ForceOption = False,
    config: ConfigOption = None,
    set_values: SetOption = None,
) -> None:
    """Follow the stereo camera of a drive: six degrees of freedom, and the car's planar motion.

    Examples:
        polemap odometry kitti/sequences/03 --out 03.tum
        polemap odometry drives/monday --out monday.tum --csv odometry.csv

    The TUM file holds poses of the left camera (x right, y down, z forward) in the axes of the
    first one, as KITTI has them; evo reads it. The CSV holds rear-axle speed, yaw rate and lateral
    speed with standard deviations, for steps that are known; it can stand in a drive folder as
    odometry.csv.
    """
    check_files([out, table], (drive, config, topics))
    check_own_kind(out, (".tum",))
    if table is not None:
        check_own_kind(table, (".csv",))
    load_settings(config, set_values)
    opened = open_drive(drive, topics=topics)
    opened = opened.lap(lap) if lap is not None else opened
    if not opened.has_frames:
        raise InputError(f"drive {opened.name}: camera odometry needs stereo pictures, it has none")
    require_plausible(opened.name, find(opened), force=force)
    with progress(len(opened.frame_stamps_s), "following the camera") as advance:
        track = track_camera(opened, advance)
    if not len(track.planar):
        raise InputError(
            f"drive {opened.name}: no step of {len(track.stamp_s)} pairs is known "
            f"({_reasons(track)}); look at a pair with polemap disparity"
        )
    with atomic_file(out) as part:
        part.write_text(spatial_tum_text(track.stamp_s, track.poses), encoding="utf-8")
    if table is not None:
        with atomic_file(table) as part:
            part.write_text(_csv(track.planar), encoding="utf-8")
    typer.echo(_summary(track, out, table))


def _csv(planar: PlanarMotion) -> str:
    columns = planar.arrays()
    lines = [",".join(columns)]
    for row in zip(*columns.values(), strict=True):
        cells = (f"{v:.{_DIGITS.get(n, 7)}f}" for n, v in zip(columns, row, strict=True))
        lines.append(",".join(cells))
    return "\n".join(lines) + "\n"


def _reasons(track: CameraTrack) -> str:
    return ", ".join(f"{count} x {kind}" for kind, count in sorted(track.unknown.items()))


def _summary(track: CameraTrack, out: Path, table: Path | None) -> str:
    planar, steps = track.planar, len(track.stamp_s) - 1
    way = float(np.linalg.norm(np.diff(track.poses[:, :3, 3], axis=0), axis=1).sum())
    lines = [
        f"{steps} steps over {way:.1f} m, {len(planar)} known"
        + (f" ({_reasons(track)})" if track.unknown else ""),
        f"stated deviation of a step (median): speed {np.median(planar.speed_sd_mps):.3f} m/s, "
        f"yaw rate {np.degrees(np.median(planar.yaw_rate_sd_radps)):.3f} deg/s",
        f"error of the disparities amid the picture, learned: {track.disparity_offset_px:+.2f} px",
    ]
    if table is not None:
        lines.append(f"wrote {table}")
    return "\n".join([*lines, f"wrote {out}"])
