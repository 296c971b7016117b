"""`polemap calibrate`: what a drive itself says of its calibration."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from polemap.calibration.check import calibrate
from polemap.calibration.result import Calibration
from polemap.calibration.rows import RowAgreement
from polemap.drivelog.atomic import atomic_file, atomic_folder, check_files, check_folder
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import OutputError
from polemap.drivelog.readers.registry import open_drive
from polemap.parsing.json_text import plain_values
from polemap.settings import load_settings
from polemap.tools.option_types import ConfigOption, SeedOption, SetOption, TopicsOption
from polemap.tools.progress import progress

PICTURES = "calibration pictures"
_MADE_BY = "# found by polemap calibrate"


def command(
    drive: Annotated[Path, typer.Argument(help="A drive of any known kind.")],
    out: Annotated[
        Path | None, typer.Option("--out", help="YAML file in the keys of drive.yaml.")
    ] = None,
    pictures: Annotated[
        Path | None, typer.Option("--pictures", help="Folder of pictures of what was found.")
    ] = None,
    pairs: Annotated[
        int, typer.Option("--pairs", min=5, help="Pairs whose rows and road are looked at.")
    ] = 40,
    frames: Annotated[
        int, typer.Option("--frames", min=30, help="Frames whose motion is followed.")
    ] = 240,
    as_json: Annotated[bool, typer.Option("--json", help="The result as JSON on stdout.")] = False,
    topics: TopicsOption = None,
    seed: SeedOption = 0,
    config: ConfigOption = None,
    set_values: SetOption = None,
) -> None:
    """Check the calibration of a drive, and estimate what its pictures and streams say of it.

    Examples:
      polemap calibrate drives/monday
      polemap calibrate drives/monday --out found.yaml --pictures found
      polemap calibrate kitti/sequences/03 --json

    Rows of the pair, height, pitch and roll over the road, yaw against the way the car moves, scale
    and delay of the odometry, each with its standard deviation. A warning says where the drive
    contradicts what it states. docs/calibration.md tells how, and how well.
    """
    if out is not None and out.suffix.lower() not in (".yaml", ".yml"):
        raise OutputError(f"{out}: what was found is written as .yaml")
    check_files([out], (drive, config, topics))
    _check_own(out)
    if pictures is not None:
        check_folder(pictures, PICTURES, (drive, config, topics))
    settings = load_settings(config, set_values)
    opened = open_drive(drive, seed=seed, topics=topics)
    total = 2 * pairs + min(frames, len(opened.frame_stamps_s))
    with progress(total, "calibrating") as advance:
        found = calibrate(
            opened, settings.stereo, pairs=pairs, frames=frames, seed=seed, advance=advance
        )
    if out is not None:
        with atomic_file(out) as part:
            part.write_text(as_yaml(opened, found), encoding="utf-8")
    if pictures is not None:
        from polemap.tools.calibration_pictures import write_pictures

        with atomic_folder(pictures, PICTURES) as folder:
            write_pictures(opened, found, settings.stereo, folder)
    if as_json:
        typer.echo(json.dumps(as_dict(opened, found), indent=2))
        return
    typer.echo("\n".join(describe(opened, found, out)))


def _check_own(out: Path | None) -> None:
    """A settings or drive file of the user's is not replaced by what was found."""
    if out is None or not out.is_file():
        return
    with out.open("rb") as stream:
        start = stream.read(len(_MADE_BY))
    if start and start != _MADE_BY.encode():
        raise OutputError(f"{out}: is no file of polemap calibrate's; choose another name")


def describe(drive: Drive, found: Calibration, out: Path | None = None) -> list[str]:
    """The result as lines."""
    lines = [f"drive      {drive.name} ({drive.path})"]
    if found.rows is not None:
        lines += _describe_rows(found.rows)
    lines.append(f"{'quantity':<44}{'stated':>10}{'found':>10}{'sd':>9}  from")
    for q in found.quantities:
        degrees = q.name.endswith("_rad")
        size = float(np.degrees(1.0)) if degrees else 1.0
        name = q.name.replace("_rad", " (degrees)") if degrees else q.name
        lines.append(
            f"{name:<44}{q.stated * size:10.3f}{q.found * size:10.3f}{q.sd * size:9.3f}  {q.source}"
        )
    for error in found.odometry[1:]:
        delay = f", delay {error.delay_s:.3f} s" if np.isfinite(error.delay_s) else ""
        lines.append(
            f"           odometry against {error.against}: speed scale {error.speed_scale:.4f} +- "
            f"{error.speed_scale_sd:.4f}{delay}"
        )
    if (scale := found.camera_scale()) is not None:
        lines.append(
            f"           ways by the camera are {scale[0]:.4f} +- {scale[1]:.4f} of the reference's"
        )
    lines += [f"unknown    {text}" for text in found.missing]
    warnings = found.findings()
    lines += [f"warning    {finding.line()}" for finding in warnings]
    if not warnings:
        lines.append("warning    none: the drive agrees with its calibration")
    if out is not None:
        lines.append(f"written    {out}: copy its keys into drive.yaml")
    elif warnings:
        lines.append("next       --out found.yaml writes what was found in the keys of drive.yaml")
    return lines


def _describe_rows(rows: RowAgreement) -> list[str]:
    angles = np.degrees(
        [rows.pitch_rad, rows.pitch_sd_rad, rows.roll_rad, rows.roll_sd_rad, rows.yaw_rad,
         rows.yaw_sd_rad]
    )  # fmt: skip
    return [
        f"rows       {rows.matches} features in {rows.frames} pairs: right picture "
        f"{rows.median_px:+.2f} px lower in the median (spread {rows.spread_px:.2f}, 95 % "
        f"within {rows.p95_px:.2f} px, "
        f"{rows.across_px:.2f} px between parts of the picture)",
        "           as if the right camera were turned: pitch {:.3f} +- {:.3f}, roll {:.3f} +- "
        "{:.3f}, yaw {:.3f} +- {:.3f} degrees;".format(*angles),
        f"           its focal length {100 * rows.focal_ratio:+.3f} +- "
        f"{100 * rows.focal_ratio_sd:.3f} %, it stood {1000 * rows.lower_m:+.1f} +- "
        f"{1000 * rows.lower_sd_m:.1f} mm lower; {rows.rest_px:.2f} px are left",
    ]


def as_yaml(drive: Drive, found: Calibration) -> str:
    """What was found in the keys of drive.yaml, standard deviations as comments."""
    lines = [
        f"{_MADE_BY} in drive {drive.name}; behind # the standard deviation",
    ]
    mount = [q for q in found.quantities if q.name.startswith("camera.")]
    if mount and drive.rig is not None:
        stated = drive.rig.vehicle_from_camera
        lines += ["camera:", "  vehicle_from_camera:"]
        known = {q.name.rpartition(".")[2]: q for q in mount}
        for name in ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad"):
            if name in known:
                lines.append(f"    {name}: {known[name].found:.5f}  # {known[name].sd:.5f}")
            else:
                lines.append(f"    {name}: {getattr(stated, name):.5f}  # as stated")
    odometry = [q for q in found.quantities if q.name.startswith("odometry.")]
    if odometry:
        lines.append("odometry:")
        lines += [f"  {q.name.rpartition('.')[2]}: {q.found:.5f}  # {q.sd:.5f}" for q in odometry]
    return "\n".join(lines) + "\n"


def as_dict(drive: Drive, found: Calibration) -> dict[str, Any]:
    """The result as JSON has it; what is not known is null."""
    rows = None
    if found.rows is not None:
        rows = {**asdict(found.rows), "grid_px": found.rows.grid_px.tolist()}
        rows["across_px"] = found.rows.across_px
    tree: dict[str, Any] = {
        "drive": drive.name,
        "rows": rows,
        "quantities": [{**asdict(q), "contradicts": q.contradicts} for q in found.quantities],
        "odometry": [asdict(error) for error in found.odometry],
        "camera_scale": found.camera_scale(),
        "missing": list(found.missing),
        "findings": [finding.to_dict() for finding in found.findings()],
    }
    cleaned: dict[str, Any] = plain_values(tree)
    return cleaned
