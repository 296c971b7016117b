"""`polemap map`: build, update, compare and convert pole maps."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from polemap.build.build_map import BuiltMap, assemble_map, build_map, unique_names
from polemap.build.city.cluster import open_cluster
from polemap.build.city.io import clear
from polemap.build.city.tiles import TILE_M
from polemap.build.city.work import DriveTask, observe_all, on_workers
from polemap.build.map_diff import CHANGE, DISTANCE, compare_maps, diff_map
from polemap.drivelog.atomic import check_files, reserved
from polemap.drivelog.drive import Drive, open_drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.jobs import LocalWorkers, Workers
from polemap.map.io import check_writable, export_map, read_map, write_map
from polemap.map.pole_map import PoleMap
from polemap.settings import Settings, load_settings
from polemap.tools.drive_detection import Source
from polemap.tools.findings import require_plausible
from polemap.tools.map_picture import (
    check_picture,
    draw_map,
    route_localizability,
    write_localizability,
)
from polemap.tools.map_worker import observe_task, scan
from polemap.tools.option_types import (
    ConfigOption,
    ForceOption,
    OdometryOption,
    SeedOption,
    SetOption,
    TopicsOption,
)
from polemap.tools.plausible import find
from polemap.tools.progress import progress


@dataclass(frozen=True, slots=True)
class _Place:
    """Where the poles of drives are detected."""

    checkpoints: Path
    workers: int | None
    scheduler: str | None

    def opened(self, drives: int) -> AbstractContextManager[Workers]:
        """The workers of the scheduler, or processes of this machine."""
        if self.scheduler is not None:
            return open_cluster(self.scheduler)
        return nullcontext(LocalWorkers(min(self.workers or 1, max(drives, 1))))


def command(
    drives: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Drives with reference poses, of any known kind; two maps with --diff."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Map to write: .gpkg, .geojson or .parquet.")
    ] = None,
    lap: Annotated[str | None, typer.Option("--lap", help="Keep to this row of laps.csv.")] = None,
    update: Annotated[
        Path | None, typer.Option("--update", help="A map to bring up to date with the drives.")
    ] = None,
    align: Annotated[
        bool, typer.Option("--align", help="Lay drives onto each other before merging.")
    ] = False,
    diff: Annotated[
        bool, typer.Option("--diff", help="Compare two maps instead: polemap map --diff A B.")
    ] = False,
    convert: Annotated[
        Path | None,
        typer.Option("--convert", help="A map or inventory to write in another format instead."),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="Draw map and routes: .png, .svg or .pdf.")
    ] = None,
    layer: Annotated[
        Path | None,
        typer.Option("--localizability", help="Bounds on the pose along the routes: .geojson."),
    ] = None,
    workers: Annotated[
        int | None, typer.Option("--workers", min=1, help="Local processes, a drive each.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", help="Dask scheduler, such as tcp://host:8786.")
    ] = None,
    topics: TopicsOption = None,
    odometry: OdometryOption = "auto",
    force: ForceOption = False,
    seed: SeedOption = 0,
    config: ConfigOption = None,
    set_values: SetOption = None,
) -> None:
    """Build one pole map from one or many drives that have reference poses.

    Examples:
        polemap map drives/monday --out campus.gpkg
        polemap map drives/park --lap map --out park.geojson
        polemap map drives/tuesday drives/friday --update campus.gpkg --align --out campus.gpkg
        polemap map drives/* --workers 8 --out city.parquet
        polemap map drives/monday --out a.gpkg --picture a.png --localizability route.geojson
        polemap map --diff campus_old.gpkg campus.gpkg --out changes.geojson
        polemap map --convert lamps.osm --out lamps.gpkg
        polemap map --convert campus.gpkg --out campus.xodr

    The ending of --out chooses the format. Poles that were seen too seldom for how often they were
    in view are left out; `docs/maps.md` has the rules and the columns.
    """
    written = [out, picture, layer]
    check_files(written, [*(drives or []), convert, config, topics])
    # a map may be brought up to date in its place, pictures of it may not stand there
    check_files(written[1:], [update])
    settings = load_settings(config, set_values)
    if diff:
        _compare(drives or [], out, align)
        return
    if convert is not None:
        _convert(convert, drives or [], out, seed, topics)
        return
    if not drives:
        raise InputError("no drive is given: polemap map DRIVE... --out MAP")
    if out is None:
        raise InputError("--out is missing: it names the map to write, such as campus.gpkg")
    check_writable(out)
    check_picture(picture)
    with reserved(out):
        serial = workers is None and scheduler is None
        mapping = None if topics is None else str(topics.resolve())
        parts = [Source(str(path), lap, mapping, odometry) for path in drives]
        opened = [part.open(seed) if serial else part.recorded(seed) for part in parts]
        for drive in opened:
            require_plausible(drive.name, find(drive), force=force)
        # the map keeps its own zone: drives come to it
        old = read_map(update, allow_empty=True) if update is not None else None
        for note in old.notes if old is not None else ():
            typer.echo(f"note: {update}: {note}")
        place = _Place(out.parent / f".{out.name}.checkpoints", workers, scheduler)
        if serial:
            built = _build(opened, settings, old, align)
        else:
            tasks = _tasks(drives, opened, lap, seed, settings, old, mapping, odometry)
            built = _build_in_processes(opened, tasks, settings, old, align, place)
        if not len(built.pole_map):
            raise InputError(
                f"no pole was found in {len(opened)} drives, {out} was not written; try a lower "
                "--set polemap.mapping.observations_min"
            )
        write_map(built.pole_map, out)
        if place.checkpoints.is_dir():
            clear(place.checkpoints)
        _show(built.pole_map, opened, settings, picture, layer)
        _say(built, opened, out)


def _compare(maps: list[Path], out: Path | None, align: bool) -> None:
    if len(maps) != 2:
        raise InputError(f"--diff compares two maps, {len(maps)} are given: --diff OLD NEW")
    if out is not None:
        check_writable(out)
    before = read_map(maps[0], allow_empty=True)
    after = read_map(maps[1], before.frame, allow_empty=True)
    found = compare_maps(before, after, align=align)
    changes = diff_map(before, after, found)
    if found.shift.significant:
        east, north = found.shift.move_m
        remedy = "it was taken away" if align else "--align would take it away"
        typer.echo(
            f"note: {maps[1]} is off by {-east:+.2f} m east, {-north:+.2f} m north; {remedy}"
        )
    if out is not None:
        write_map(changes, out)
    typer.echo(
        f"{len(found.added)} added, {len(found.removed)} removed, {len(found.moved)} moved, "
        f"{len(found.same)} as before"
    )
    for row in range(len(changes)):
        east, north = changes.points_m[row]
        distance = changes.extra[DISTANCE][row]
        far = f" by {distance:.2f} m" if np.isfinite(distance) else ""
        change = changes.extra[CHANGE][row]
        typer.echo(f"{change:<8} pole {changes.ids[row]} at {east:.2f}, {north:.2f}{far}")


def _convert(
    source: Path, drives: list[Path], out: Path | None, seed: int, topics: Path | None
) -> None:
    if out is None:
        raise InputError("--out is missing: its ending chooses the format to convert to")
    frame = open_drive(drives[0], seed=seed, topics=topics).frame if drives else None
    pole_map = read_map(source, frame)
    export_map(pole_map, out)
    for note in pole_map.notes:
        typer.echo(f"note: {note}")
    typer.echo(f"{out}: {len(pole_map)} poles in {pole_map.frame}")


def _build(drives: list[Drive], settings: Settings, old: PoleMap | None, align: bool) -> BuiltMap:
    total = sum(len(d.frame_stamps_s) if d.has_frames else len(d.scans) for d in drives)
    with progress(total, "detecting poles") as advance:
        return build_map(
            drives,
            settings.polemap,
            lambda drive: scan(drive, settings, advance),
            update=old,
            align=align,
        )


def _tasks(
    paths: list[Path],
    drives: list[Drive],
    lap: str | None,
    seed: int,
    settings: Settings,
    old: PoleMap | None,
    mapping: str | None,
    odometry: str,
) -> list[DriveTask]:
    """A task a drive, for workers that open it by themselves."""
    frame = old.frame if old is not None else drives[0].frame
    text = settings.model_dump_json()
    return [
        DriveTask(str(path.resolve()), name, lap, seed, frame, text, mapping, odometry)
        for path, name in zip(paths, unique_names(drives), strict=True)
    ]


def _build_in_processes(
    drives: list[Drive],
    tasks: list[DriveTask],
    settings: Settings,
    old: PoleMap | None,
    align: bool,
    place: _Place,
) -> BuiltMap:
    """The same map by workers, a drive each; what they finished survives a killed run."""
    mapping = settings.polemap.mapping
    with place.opened(len(tasks)) as workers:
        with progress(len(drives), "drives") as advance:
            parts = observe_all(tasks, observe_task, place.checkpoints, workers, advance)
        with progress(None, "merging tiles") as advance:
            return assemble_map(
                parts,
                mapping,
                tasks[0].frame,
                update=old,
                align=align,
                run=on_workers(workers, advance),
                tile_m=TILE_M,
            )


def _show(
    pole_map: PoleMap,
    drives: list[Drive],
    settings: Settings,
    picture: Path | None,
    layer: Path | None,
) -> None:
    """Bounds on the pose along the routes, as a layer and in a picture."""
    if picture is None and layer is None:
        return
    routes = [route_localizability(pole_map, drive, settings) for drive in drives]
    if layer is not None:
        write_localizability(routes, pole_map.frame, layer)
    if picture is not None:
        draw_map(pole_map, routes, picture)


def _say(built: BuiltMap, drives: list[Drive], out: Path) -> None:
    for drive in drives:
        for note in drive.notes:
            typer.echo(f"note: {drive.name}: {note}")
        for problem, count in drive.problems.items():
            typer.echo(f"note: {drive.name}: {count} x {problem.replace('_', ' ')}")
    for report in built.reports:
        typer.echo(f"note: {report}")
    if len(built.removed):
        typer.echo(f"{len(built.removed)} poles of the old map are gone")
    made = built.pole_map
    sd_m = np.sqrt(np.linalg.eigvalsh(made.covariance_m2)[:, -1])
    typer.echo(f"{out}: {len(made)} poles in {made.frame}")
    typer.echo(
        f"known to {np.median(sd_m):.2f} m (median of the larger axis), existence "
        f"{np.mean(made.existence):.2f} on average, seen {np.median(made.observations):.0f} times"
    )
    typer.echo(f"next: polemap localize DRIVE --map {out} --out runs/DRIVE")
