"""`polemap where`: the place of a car in a map of any size, by the poles along its way alone."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from os import cpu_count
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from polemap.drivelog.atomic import check_file
from polemap.drivelog.errors import InputError
from polemap.localize.config import for_car
from polemap.localize.place.along import Found, find_along
from polemap.localize.place.finder import WRONG_MOST, WRONG_MOST_HIGHEST, Search
from polemap.map.pattern_index.index import PatternIndex
from polemap.map.pattern_index.io import index_file
from polemap.settings import load_settings
from polemap.tools.drive_detection import Source, detect_drive
from polemap.tools.findings import require_plausible
from polemap.tools.map_picture import check_picture
from polemap.tools.option_types import (
    ConfigOption,
    ForceOption,
    OdometryOption,
    SetOption,
    TopicsOption,
)
from polemap.tools.pattern_index import opened_index
from polemap.tools.plausible import find
from polemap.tools.progress import progress
from polemap.tools.where_picture import draw_place


def command(
    drive: Annotated[Path, typer.Argument(help="Drive of any known kind.")],
    map_file: Annotated[
        Path, typer.Option("--map", help="Pole map: gpkg, geojson, parquet, csv, or a folder.")
    ],
    at_s: Annotated[
        float, typer.Option("--at", min=0.0, help="Begin so many seconds into the drive.")
    ] = 0.0,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", help="Draw the place with the poles seen: .png, .svg or .pdf."),
    ] = None,
    wrong_most: Annotated[
        float,
        typer.Option(
            "--wrong-most",
            min=1e-9,
            max=WRONG_MOST_HIGHEST,
            help="Share of claims that may be wrong.",
        ),
    ] = WRONG_MOST,
    lap: Annotated[str | None, typer.Option("--lap", help="A row of laps.csv.")] = None,
    workers: Annotated[
        int | None, typer.Option("--workers", min=1, help="Processes; default: cores.")
    ] = None,
    topics: TopicsOption = None,
    odometry: OdometryOption = "auto",
    force: ForceOption = False,
    config: ConfigOption = None,
    set_values: SetOption = None,
) -> int:
    """Find a car anywhere in a map by the poles along its way; no GNSS, no start is used.

    Examples:
        polemap where drives/lap_2 --map city.parquet
        polemap where drives/lap_2 --map city.parquet --at 30 --json
        polemap where drives/lap_2 --map campus.gpkg --picture place.png

    Prints the place, how far had to be driven for it, a bound on the probability that it is wrong,
    and the runner-up. The map's index of patterns is built beside it on first need. Exit code 0,
    too, where no place can be claimed: it says so.
    """
    settings = load_settings(config, set_values)
    check_picture(picture)
    if picture is not None:
        check_file(picture, (drive, map_file, config, topics))
    source = Source(str(drive), lap, None if topics is None else str(topics), odometry)
    opened = source.open()
    require_plausible(opened.name, find(opened), force=force)
    if opened.odometry is None or not len(opened.odometry):
        raise InputError(f"drive {opened.name}: it has no odometry; --odometry camera follows it")
    if not opened.has_frames and not opened.scans:
        raise InputError(
            f"drive {opened.name}: it has neither images nor {opened.names.poles} to be found by"
        )
    lasts_s = float(opened.odometry.stamp_s[-1] - opened.odometry.stamp_s[0])
    if at_s > lasts_s:
        raise InputError(f"--at {at_s:g}: drive {opened.name} lasts {lasts_s:.1f} s; begin earlier")
    processes = workers or cpu_count() or 1
    index = opened_index(map_file, opened.frame, processes)
    if not index.triangles:
        raise InputError(
            f"{map_file}: {len(index)} poles of which no three stand within 30 m; no car is found "
            "by them"
        )
    total = len(opened.frame_stamps_s) if opened.has_frames else len(opened.scans)
    with progress(total, "detecting poles") as advance:
        scans = detect_drive(source, opened, settings, processes, None, advance).scans
    begin_s = float(opened.odometry.stamp_s[0]) + at_s
    localize = for_car(settings.localize, opened.car)
    with progress(len(scans), "searching") as advance, _about(map_file):
        found = find_along(
            scans,
            opened.odometry,
            index,
            since_s=begin_s,
            slip_rad_per_mps2=localize.odometry.rear_slip_rad_per_mps2,
            wrong_most=wrong_most,
            advance=advance,
        )
    typer.echo(json.dumps(_record(found, index)) if as_json else _told(found, index, wrong_most))
    if picture is not None:
        draw_place(index, found, picture)
    return 0


@contextmanager
def _about(map_file: Path) -> Iterator[None]:
    """What is wrong with the numbers in an index shows when they are used; the file is named."""
    try:
        yield
    except InputError as error:
        name = f"{index_file(map_file)}: "
        raise InputError(name + str(error).removeprefix(name)) from error


def _record(found: Found, index: PatternIndex) -> dict[str, Any]:
    """What --json prints."""
    search = found.search
    record: dict[str, Any] = {
        "found": found.claimed, "east_m": None, "north_m": None, "yaw_rad": None,
        "after_m": round(found.after_m, 2), "after_s": round(found.after_s, 3),
        "runner_up": None, "stamp_s": None, "frame": index.frame.to_dict(),
    }  # fmt: skip
    if search is None or not len(search.poses):
        return record | {"wrong_at_most": None, "bound": 1.0, "poles": 0, "matched": 0}
    if found.claimed:
        record |= _pose(search.poses[0]) | {
            "stamp_s": found.stamp_s,
            "sd_m": float(np.sqrt(np.linalg.eigvalsh(search.covariance[0, :2, :2])[-1])),
        }
    if len(search.poses) > 1:
        less = float(search.log_evidence[0] - search.log_evidence[1])
        record["runner_up"] = _pose(search.poses[1]) | {"log_evidence_less": less}
    return record | {
        # a probability of claims only; of others it says how far they are from being one
        "wrong_at_most": search.wrong_at_most if found.claimed else None,
        "bound": search.wrong_at_most,
        "poles": search.poles, "matched": int(search.matched[0]),
    }  # fmt: skip


def _pose(pose: NDArray[np.float64]) -> dict[str, float]:
    return dict(zip(("east_m", "north_m", "yaw_rad"), pose.tolist(), strict=True))


def _told(found: Found, index: PatternIndex, wrong_most: float) -> str:
    """What is printed for people."""
    way = f"{found.after_m:.0f} m ({found.after_s:.1f} s)"
    search = found.search
    if search is None or not len(search.poses):
        return f"no place can be claimed after {way}: too few poles were seen twice"
    best = search.poses[0]
    place = f"east {best[0]:.2f} m, north {best[1]:.2f} m, yaw {np.degrees(best[2]):.1f} deg"
    poles = f"{search.matched[0]} of {search.poles} poles seen stand on the map's"
    rivals = _rivals(search)
    if not found.claimed:
        return (
            f"no place can be claimed after {way}: the bound of the best, {place}, is "
            f"{search.wrong_at_most:.2g}, and {wrong_most:g} is asked for; {poles}; {rivals}"
        )
    sd_m = np.sqrt(np.linalg.eigvalsh(search.covariance[0, :2, :2])[-1])
    return (
        f"found after {way}: {place} in {index.frame}, sd {sd_m:.2f} m\n"
        f"wrong with a probability of {search.wrong_at_most:.2g} at most; {poles}\n{rivals}"
    )


def _rivals(search: Search) -> str:
    if len(search.poses) < 2:
        return "no other place comes into question"
    less = search.log_evidence[0] - search.log_evidence[1]
    away_m = np.hypot(*(search.poses[1, :2] - search.poses[0, :2]))
    return f"the runner-up, {away_m:.0f} m away, explains exp({less:.0f}) times less"
