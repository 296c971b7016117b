"""`polemap info`: what is inside a drive or a map."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from polemap.drivelog.atomic import check_file
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.findings import Finding
from polemap.drivelog.frames import convergence_rad, geographic_from_grid, point_scale
from polemap.drivelog.landmark_kind import LandmarkKind, kind_counts
from polemap.drivelog.readers.bags.files import is_log
from polemap.drivelog.readers.registry import open_drive
from polemap.errors import PolemapError
from polemap.map.city.city_map import CityMap, statistics_of
from polemap.map.city.io import open_map
from polemap.map.files.io import map_files
from polemap.map.io import MAP_ENDINGS
from polemap.map.plausibility import check_map, check_map_of_drive
from polemap.map.pole_map import PoleMap
from polemap.tools.option_types import SeedOption, TopicsOption
from polemap.tools.plausible import find

Floats = NDArray[np.float64]

_GAP_PERIODS = 3.0


def command(
    path: Annotated[Path, typer.Argument(help="A drive of any known kind, or a map.")],
    frame_of: Annotated[
        Path | None, typer.Option("--drive", help="The drive that a CSV map belongs to.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="The findings alone, as a list; exit 2 with errors.")
    ] = False,
    topics: TopicsOption = None,
    write_mapping_to: Annotated[
        Path | None,
        typer.Option("--write-mapping", help="File to write the use of a log's topics to."),
    ] = None,
    seed: SeedOption = 0,
) -> None:
    """Say what is inside a drive (streams, rates, gaps, extent, calibration) or a map.

    Examples:
        polemap info drives/monday
        polemap info campus.gpkg
        polemap info poles.csv --drive drives/monday
        polemap info drives/monday --json
        polemap info drive.mcap --write-mapping topics.yaml

    Streams are held against each other under "plausible?": what the other commands refuse
    ("error") or warn of. docs/drives.md lists the findings.
    """
    if as_json:
        found = _findings(path, frame_of, topics, seed)
        typer.echo(json.dumps([finding.to_dict() for finding in found], indent=2))
        if any(finding.severity == "error" for finding in found):
            raise typer.Exit(2)
        return
    if _is_map(path):
        frame = (
            open_drive(frame_of, seed=seed, topics=topics).frame if frame_of is not None else None
        )
        pole_map = open_map(path, frame, allow_empty=True)
        lines = describe_map(pole_map, path) + describe_findings(check_map(pole_map))
    else:
        _describe_log(path, topics, write_mapping_to)
        drive = open_drive(path, seed=seed, topics=topics)
        lines = describe_drive(drive) + describe_findings(find(drive))
    typer.echo("\n".join(lines))


def _is_map(path: Path) -> bool:
    return (path.is_file() and path.suffix.lower() in MAP_ENDINGS) or bool(map_files(path))


def _describe_log(path: Path, topics: Path | None, write_to: Path | None) -> None:
    """The topics of a ROS bag or MCAP file, also of one that makes no drive yet."""
    if not path.exists() or not is_log(path):
        if write_to is not None:
            raise InputError(
                f"{path}: has no topics to map; --write-mapping is for ROS bags and MCAP files"
            )
        return
    if write_to is not None:
        check_file(write_to, (path, topics), (".yaml", ".yml"))
    # here, since most of what is asked about is no log, and reading this takes a while
    from polemap.drivelog.readers.bags.describe import describe_topics, write_mapping
    from polemap.drivelog.readers.bags.reader import survey

    index, made = survey(path, topics)
    typer.echo("\n".join(describe_topics(index, made)))
    if write_to is not None:
        write_mapping(made.mapping, path, write_to)
        typer.echo(f"mapping    written to {write_to}: change it, and use it with --topics")


def _findings(path: Path, frame_of: Path | None, topics: Path | None, seed: int) -> list[Finding]:
    """What is found in a drive or a map; one that cannot be read is a finding of its own."""
    try:
        drive = None
        if frame_of is not None:
            drive = open_drive(frame_of, seed=seed, topics=topics)
        if _is_map(path):
            pole_map = open_map(path, drive.frame if drive else None, allow_empty=True)
            found = check_map(pole_map)
            return found + check_map_of_drive(pole_map, drive) if drive else found
        return find(open_drive(path, seed=seed, topics=topics))
    except PolemapError as error:
        remedy = "mend what the value names"
        return [Finding("unreadable", "error", path.name, str(error), "a readable input", remedy)]


def describe_findings(found: list[Finding]) -> list[str]:
    """The section "plausible?", a line a finding."""
    if not found:
        return ["plausible? nothing speaks against it"]
    return ["plausible?", *(f"  {finding.severity:<8} {finding.line()}" for finding in found)]


def describe_drive(drive: Drive) -> list[str]:
    """What a drive holds, a line a fact."""
    start, _ = drive.span_s
    lines = [
        f"drive      {drive.name} ({drive.path})",
        f"frame      {drive.frame}",
        f"duration   {drive.duration_s:.1f} s from stamp {start:.3f}",
        f"vehicle    wheelbase {drive.wheelbase_m:.2f} m{_car(drive)}",
    ]
    lines += _camera(drive)
    if drive.has_frames:
        numbers = drive.frame_numbers
        detail = f"numbers {numbers[0]} to {numbers[-1]}"
        lines.append(_stream("images", drive.frame_stamps_s, drive.frame_arrivals_s, detail))
    if drive.odometry is not None and len(drive.odometry):
        speed = drive.odometry.speed_mps
        detail = f"speed {speed.min():.1f} to {speed.max():.1f} m/s"
        lines.append(_stream("odometry", drive.odometry.stamp_s, drive.odometry.arrival_s, detail))
    if drive.gnss is not None and len(drive.gnss):
        x, y = drive.gnss_antenna_m
        detail = f"antenna at {x:.2f}, {y:.2f} m"
        lines.append(_stream("gnss", drive.gnss.stamp_s, drive.gnss.arrival_s, detail))
    if drive.reference is not None and len(drive.reference):
        lines += _reference(drive)
    if drive.scans:
        lines += _scans(drive)
    lines += [
        f"lap        {lap.name}: {lap.start_s:.2f} to {lap.end_s:.2f} s" for lap in drive.laps
    ]
    lines += [f"note       {note}" for note in drive.notes]
    lines += [f"left out   {n} x {kind.replace('_', ' ')}" for kind, n in drive.problems.items()]
    return lines


def _scans(drive: Drive) -> list[str]:
    """Looks of the detectors of points and of lines, and what they saw, by kind."""
    told = []
    looked = [scan for scan in drive.scans if scan.view is None or not scan.view.sees_nothing]
    of_lines = [scan for scan in drive.scans if scan.lines is not None]
    kinds = [
        ("pole scans", looked, [scan.kind for scan in looked]),
        ("line scans", of_lines, [scan.lines.kind for scan in of_lines if scan.lines is not None]),
    ]
    for name, scans, seen in kinds:
        if scans:
            stamps = np.array([scan.stamp_s for scan in scans])
            arrivals = np.array([scan.arrival_s for scan in scans])
            what = kind_counts(np.concatenate(seen)) or "0 poles"
            told.append(_stream(name, stamps, arrivals, what))
    return told


def _car(drive: Drive) -> str:
    if drive.car is None:
        return ""
    slip = drive.car.rear_slip_rad_per_mps2
    return f", car {drive.car.name}, rear axle slips {slip:.4f} rad per m/s^2"


def _camera(drive: Drive) -> list[str]:
    if drive.rig is None:
        return ["camera     none"]
    rig, mount = drive.rig, drive.rig.vehicle_from_camera
    angles = np.degrees([mount.roll_rad, mount.pitch_rad, mount.yaw_rad])
    return [
        f"camera     {rig.width_px}x{rig.height_px}, focal length {rig.focal_px:.1f} px, "
        f"baseline {rig.baseline_m:.3f} m",
        f"mounting   {mount.x_m:.2f} m ahead, {mount.y_m:.2f} m left, {mount.z_m:.2f} m up; roll "
        f"{angles[0]:.2f}, pitch {angles[1]:.2f}, yaw {angles[2]:.2f} degrees",
    ]


def _stream(name: str, stamps: Floats, arrivals: Floats, detail: str) -> str:
    text = f"{name:<10} {len(stamps)}"
    if len(stamps) > 1:
        step = np.diff(stamps)
        period = float(np.median(step))
        text += f" at {1.0 / period:.1f} Hz" if period > 0 else ""
        gaps = step[step > _GAP_PERIODS * period]
        text += f", {len(gaps)} gaps to {gaps.max():.1f} s" if len(gaps) else ", no gaps"
    late = arrivals - stamps
    if len(late) and late.max() > 0.0:
        text += f", {1000 * np.median(late):.0f} ms late"
    return f"{text}; {detail}"


def _reference(drive: Drive) -> list[str]:
    reference = drive.reference
    if reference is None:
        return []
    points = reference.poses[:, :2]
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    sd = reference.sd_m[np.isfinite(reference.sd_m)]
    accuracy = f"states {np.median(sd):.3f} m" if len(sd) else "states no accuracy"
    lines = [
        _stream("reference", reference.stamp_s, reference.stamp_s, f"{length:.0f} m, {accuracy}")
    ]
    return lines + _extent(drive, points)


def _extent(where: Drive | PoleMap | CityMap, points: Floats) -> list[str]:
    low, high = points.min(axis=0), points.max(axis=0)
    lines = [
        f"extent     east {low[0]:.1f} to {high[0]:.1f} m, north {low[1]:.1f} to {high[1]:.1f} m"
    ]
    if where.frame.is_utm:
        middle = ((low + high) / 2.0)[None]
        latitude, longitude = geographic_from_grid(where.frame, middle)[0]
        turn = np.degrees(convergence_rad(where.frame, middle)[0])
        lines.append(
            f"grid       middle {latitude:.6f}, {longitude:.6f} degrees; convergence {turn:.3f} "
            f"degrees, point scale {point_scale(where.frame, middle)[0]:.6f}"
        )
    return lines


def describe_map(pole_map: PoleMap | CityMap, path: Path) -> list[str]:
    """What a map holds, a line a fact."""
    lines = [f"map        {path}", f"frame      {pole_map.frame}", f"landmarks  {len(pole_map)}"]
    if not isinstance(pole_map, PoleMap) or not pole_map.kind.any():
        lines[-1] = f"poles      {len(pole_map)}"
    known = statistics_of(pole_map)
    if known.extent_m:
        lines += _extent(pole_map, np.array(known.extent_m).reshape(2, 2))
        low, middle, high = known.position_sd_m
        lines.append(f"position   sd {low:.3f} / {middle:.3f} / {high:.3f} m an axis (5, 50, 95 %)")
        for name, count, percentiles in (
            ("width", known.widths, known.width_m), ("height", known.heights, known.height_m)
        ):  # fmt: skip
            if count:
                low, middle, high = percentiles
                lines.append(f"{name:<10} {low:.2f} / {middle:.2f} / {high:.2f} m, {count} poles")
        least, most = known.existence
        lines.append(
            f"evidence   {known.observations} observations, at most {known.drives} drives a pole, "
            f"existence {least:.2f} to {most:.2f}"
        )
        if known.neighbours:
            lines.append(f"spacing    median {known.spacing_m:.1f} m to the next pole")
    if isinstance(pole_map, PoleMap):
        if (pole_map.kind != LandmarkKind.POLE).any():
            lines.append(f"kinds      {kind_counts(pole_map.kind)}")
        if pole_map.lines is not None and len(pole_map.lines):
            along = pole_map.lines.segments
            length = np.hypot(*(along.end_m - along.start_m).T).sum()
            lines.append(f"lines      {kind_counts(pole_map.lines.kind)}, {length:.0f} m")
    from polemap.build.history import COLUMN  # here: a drive has none

    further = [name for name in known.further if name != COLUMN]
    if further:
        lines.append(f"columns    {', '.join(further)}")
    if isinstance(pole_map, CityMap):
        lines.append("opened     by tiles: its poles are read where they are needed")
    return lines + [f"note       {note}" for note in pole_map.notes]
