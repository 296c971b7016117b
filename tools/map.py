"""`polemap map`: build, update, compare and convert pole maps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from polemap.build.build_map import BuiltMap, unique_names
from polemap.build.city.io import clear
from polemap.drivelog.atomic import check_files, check_folder, reserved
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.evaluation.localizability import held_shares
from polemap.map.io import check_writable, read_map, write_map
from polemap.map.pole_map import PoleMap
from polemap.settings import Settings, load_settings
from polemap.tools.background import check_background, read_background
from polemap.tools.findings import require_plausible
from polemap.tools.map_condensed import build_condensed, is_long
from polemap.tools.map_files import compare, convert_map
from polemap.tools.map_job import MapJob, open_workers
from polemap.tools.map_picture import (
    check_picture,
    draw_map,
    route_localizability,
    write_localizability,
)
from polemap.tools.map_slam import (
    KIND,
    build_without_reference,
    check_slam,
    lacks_reference,
    slam_sentences,
    write_poses,
)
from polemap.tools.map_update import update_without_reference
from polemap.tools.option_types import (
    BackgroundOption,
    ConfigOption,
    ForceOption,
    LapOption,
    OdometryOption,
    SeedOption,
    SetOption,
    TopicsOption,
)
from polemap.tools.pattern_index import make_index
from polemap.tools.plausible import find
from polemap.tools.slam_file import remove_figures, write_figures


def command(
    drives: Annotated[
        list[Path] | None,
        typer.Argument(help="Drives of any kind; two maps with --diff."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Map to write: .gpkg, .geojson or .parquet.")
    ] = None,
    lap: LapOption = None,
    update: Annotated[
        Path | None, typer.Option("--update", help="A map to bring up to date with the drives.")
    ] = None,
    align: Annotated[
        bool, typer.Option("--align", help="Lay drives onto each other before merging.")
    ] = False,
    slam: Annotated[
        bool,
        typer.Option("--slam", help="Solve for the poses too, as where a drive has no reference."),
    ] = False,
    poses: Annotated[
        Path | None,
        typer.Option("--poses", help="Folder for the poses that were solved for, as TUM and CSV."),
    ] = None,
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
    background: BackgroundOption = None,
    layer: Annotated[
        Path | None,
        typer.Option("--localizability", help="Bounds on the pose along the routes: .geojson."),
    ] = None,
    index: Annotated[
        bool, typer.Option("--index", help="Write the index by which a car is found anywhere, too.")
    ] = False,
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
    """Build one pole map from one or many drives, with reference poses or without.

    Examples:
        polemap map drives/monday --out campus.gpkg
        polemap map drives/park --lap map --out park.geojson
        polemap map drives/tuesday drives/friday --update campus.gpkg --align --out campus.gpkg
        polemap map drives/* --workers 8 --out city.parquet --index
        polemap map --index city.parquet districts --workers 8
        polemap map drives/monday --out a.gpkg --picture a.png --localizability route.geojson
        polemap map drives/monday --out a.gpkg --picture a.png --background town.osm.pbf
        polemap map drives/taxi --slam --poses poses --out campus.gpkg
        polemap map --diff campus_old.gpkg campus.gpkg --out changes.geojson
        polemap map --convert lamps.osm --out lamps.gpkg
        polemap map --convert campus.gpkg --out campus.xodr

    The ending of --out chooses the format. Poles that were seen too seldom for how often they were
    in view are left out; `docs/maps.md` has the rules and the columns. A drive without reference
    poses needs odometry, and GNSS if the map is to lie on the earth; `docs/slam.md`.
    """
    check_files([out, picture, layer], [*(drives or []), convert, config, topics, background])
    # a map may be brought up to date in its place, pictures of it may not stand there
    check_files([picture, layer], [update])
    settings = load_settings(config, set_values)
    if diff:
        compare(drives or [], out, align)
        return
    if convert is not None:
        convert_map(convert, drives or [], out, seed, topics)
        if index and out is not None:
            _index([out], workers, scheduler)
        return
    if not drives:
        raise InputError("no drive is given: polemap map DRIVE... --out MAP")
    if index and out is None:
        _index(drives, workers, scheduler)
        return
    if out is None:
        raise InputError("--out is missing: it names the map to write, such as campus.gpkg")
    check_writable(out)
    check_picture(picture)
    check_background(background)
    if background is not None and picture is None:
        raise InputError("--background lies under a picture: add --picture map.png")
    if poses is not None:
        check_folder(poses, KIND, drives)
    with reserved(out):
        # the map keeps its own zone: drives come to it
        job = MapJob(
            drives, out, lap, _read_old(update), topics, odometry, seed, workers, scheduler, align,
            index, slam, poses, settings, update,
        )  # fmt: skip
        _make(job, picture, layer, background, force=force)


def _index(maps: list[Path], workers: int | None, scheduler: str | None) -> None:
    with open_workers(workers, scheduler) as pool:
        for path in maps:
            make_index(path, pool)


def _read_old(update: Path | None) -> PoleMap | None:
    if update is None:
        return None
    old = read_map(update, allow_empty=True)
    for note in old.notes:
        typer.echo(f"note: {update}: {note}")
    return old


def _make(
    job: MapJob, picture: Path | None, layer: Path | None, background: Path | None, *, force: bool
) -> None:
    opened = job.drives()
    for drive in opened:
        require_plausible(drive.name, find(drive), force=force)
    without = job.slam or any(map(lacks_reference, opened))
    if without:
        check_slam(opened, job.odometry, asked=job.slam)
    solved = None
    if without and job.old is not None:
        built, opened = update_without_reference(job, opened, job.old)
    elif without:
        if job.is_serial and not is_long(opened):
            solved = build_without_reference(opened, job.settings, align=job.align)
        else:
            solved = build_condensed(job, opened)
        built, opened = solved.built, list(solved.drives)
    elif job.poses is not None:
        raise InputError("--poses writes what --slam solves for; these drives have a reference")
    else:
        built = job.build(opened)
    if not len(built.pole_map) and not built.pole_map.lines:
        raise InputError(
            f"no pole was found in {len(opened)} drives, {job.out} was not written; try a lower "
            "--set polemap.mapping.observations_min"
        )
    if solved is not None and job.poses is not None:
        write_poses(job.poses, unique_names(opened), solved.result)
    write_map(built.pole_map, job.out)
    if solved is not None:
        write_figures(job.out, solved.result.summary)
    elif job.old is None:
        remove_figures(job.out)
    if job.checkpoints.is_dir():
        clear(job.checkpoints)
    _show(built.pole_map, opened, job.settings, picture, layer, background)
    for line in slam_sentences(solved.result) if solved is not None else ():
        typer.echo(line)
    _say(built, opened, job.out)
    if job.index:
        with job.pool() as pool:
            make_index(job.out, pool)


def _show(
    pole_map: PoleMap,
    drives: list[Drive],
    settings: Settings,
    picture: Path | None,
    layer: Path | None,
    background: Path | None,
) -> None:
    """Bounds on the pose along the routes, as a layer and in a picture."""
    if picture is None and layer is None:
        return
    routes = [route_localizability(pole_map, drive, settings) for drive in drives]
    if any(kind != LandmarkKind.POLE for route in routes for kind in route.by_kind):
        for kind, aside, along in held_shares(routes):
            typer.echo(f"held by {kind}: aside {aside:.0%}, along {along:.0%} of the routes")
    if layer is not None:
        write_localizability(routes, pole_map.frame, layer)
    if picture is not None:
        shown = [pole_map.points_m, *(route.poses[:, :2] for route in routes)]
        under = None
        if background is not None:
            under = read_background(background, pole_map.frame, np.concatenate(shown))
        draw_map(pole_map, routes, picture, under)


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
    typer.echo(f"{out}: {made.described} in {made.frame}")
    if len(made):
        typer.echo(_known(made))
    typer.echo(f"next: polemap localize DRIVE --map {out} --out runs/DRIVE")


def _known(made: PoleMap) -> str:
    sd_m = np.sqrt(np.linalg.eigvalsh(made.covariance_m2)[:, -1])
    return (
        f"known to {np.median(sd_m):.2f} m (median of the larger axis), existence "
        f"{np.mean(made.existence):.2f} on average, seen {np.median(made.observations):.0f} times"
    )
