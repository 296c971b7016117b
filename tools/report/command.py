"""`polemap report`: repeatability and accuracy over laps and Monte Carlo runs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from math import isfinite, nan
from os import cpu_count
from pathlib import Path
from typing import Annotated, cast

import numpy as np
import typer

from polemap.drivelog.atomic import atomic_folder, check_folder
from polemap.drivelog.errors import ConfigError, InputError
from polemap.drivelog.plausibility.check import check_drive
from polemap.evaluation.alignment import ALIGNMENTS, Alignment
from polemap.evaluation.exclusions import parse_interval
from polemap.evaluation.io import open_routes
from polemap.evaluation.results import RouteResult
from polemap.evaluation.route import evaluate_route, route_systems
from polemap.evaluation.routes import Route
from polemap.evaluation.runs.io import read_run_set
from polemap.tools.background import Background, check_background, read_background
from polemap.tools.findings import require_plausible
from polemap.tools.option_types import BackgroundOption, ForceOption, SeedOption
from polemap.tools.progress import progress
from polemap.tools.report.sweep_spec import parse_sweeps
from polemap.tools.report.sweeps import run_sweeps

KIND = "report"
# what sweeps keep lies in the report unless --cache says otherwise
CARRIED = ("cache",)


def command(
    runs: Annotated[list[Path], typer.Argument(help="Run folders of 'polemap localize'.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for the report.")],
    exclude: Annotated[
        list[str] | None,
        typer.Option(
            "--exclude",
            help="Leave out [ROUTE/]A:B (seconds of the recording) or [ROUTE/]Am:Bm (metres).",
        ),
    ] = None,
    add: Annotated[
        list[str] | None,
        typer.Option("--add", help="Another system's trajectory: NAME=FILE.tum, see --align."),
    ] = None,
    align: Annotated[
        str,
        typer.Option(
            "--align",
            help="What is done to added trajectories first, as evo: none, origin, se2, time, "
            "time,origin or time,se2.",
        ),
    ] = "none",
    sweep: Annotated[
        list[str] | None,
        typer.Option(
            "--sweep",
            help="Replay under other settings: frame_rate=full,half, particles=100,1000 or "
            "SETTING=VALUE,VALUE. May be given several times.",
        ),
    ] = None,
    sweep_runs: Annotated[
        int, typer.Option("--sweep-runs", min=1, max=10_000, help="Seeds a value of a sweep.")
    ] = 10,
    workers: Annotated[
        int | None, typer.Option("--workers", min=1, help="Processes of a sweep; default: cores.")
    ] = None,
    cache: Annotated[
        Path | None,
        typer.Option("--cache", help="Of a sweep, as in localize; default: OUT/cache."),
    ] = None,
    background: BackgroundOption = None,
    latex: Annotated[bool, typer.Option("--latex", help="Write tables.tex too.")] = False,
    force: ForceOption = False,
    seed: SeedOption = 0,
) -> None:
    """Report repeatability, accuracy, timing and events of runs, as a page and as JSON.

    Examples:
        polemap report runs/lap_2 --out report
        polemap report runs/campus runs/avenue runs/suburb --out report --latex
        polemap report runs/campus --out report --background town.osm.pbf
        polemap report runs/campus --sweep particles=50,200,1000 --sweep-runs 20 --out report
        polemap report runs/campus --add mine=slam.tum --exclude 410:450 --out report

    Runs over the same course are one route; a route driven at least twice in one direction gets a
    repeatability. docs/repeatability.md defines every figure. A sweep keeps what it finds in a
    cache: a killed one goes on where it was.
    """
    # matplotlib is slow to import, and its absence is told before the work
    from polemap.tools.report.sweep_output import sweep_output
    from polemap.tools.report.write import NO_SWEEPS, write_report

    if cache is not None and os.path.realpath(cache) == os.path.realpath(out / "cache"):
        cache = None
    added = parse_added(add or [])
    alignment = parse_alignment(align)
    check_folder(out, KIND, [*runs, *added.values(), cache, background], CARRIED)
    check_background(background)
    intervals = [parse_interval(text) for text in exclude or []]
    swept = parse_sweeps(sweep or [])
    routes = open_routes([read_run_set(path) for path in runs], added, alignment=alignment)
    check_folder(out, KIND, _made_from(routes), CARRIED)
    under = _backgrounds(background, routes)
    _require_plausible(routes, force=force)
    unknown = {i.route for i in intervals if i.route} - {route.name for route in routes}
    if unknown:
        known = ", ".join(route.name for route in routes)
        raise ConfigError(f"--exclude: no route is called '{min(unknown)}'; there are: {known}")
    total = sum(len(system.tracks) for route in routes for system in route_systems(route))
    with progress(total, "measuring") as advance:
        results = [evaluate_route(route, intervals, advance) for route in routes]
    output = NO_SWEEPS
    if swept:
        cores = workers or cpu_count() or 1
        found = run_sweeps(
            results, swept, cache or out / "cache", sweep_runs, seed, cores, progress
        )
        output = sweep_output(*found)
    with atomic_folder(out, KIND, carried=CARRIED) as folder:
        write_report(results, folder, output, latex=latex, seed=seed, backgrounds=under)
    typer.echo(screen_table(results))
    typer.echo(f"wrote {out / 'report.html'} and {out / 'report.json'}")


def _backgrounds(path: Path | None, routes: Sequence[Route]) -> list[Background | None]:
    """What lies under each route.

    Raises:
        InputError: nothing does, or where on the earth a route lies is not known.
    """
    if path is None:
        return [None] * len(routes)
    found: list[Background | None] = []
    for route in routes:
        drives = [one.drive for one in route.recordings if one.drive is not None]
        frames = [route.pole_map.frame] if route.pole_map is not None else []
        frames += [drive.frame for drive in drives]
        if not frames:
            raise InputError(
                f"route {route.name}: neither its map nor its drive can be read, so where on the "
                "earth it lies is not known: leave out --background"
            )
        line = np.concatenate([one.guide.poses[:, :2] for one in route.recordings])
        found.append(read_background(path, frames[0], line))
    return found


def _require_plausible(routes: Sequence[Route], *, force: bool) -> None:
    """The drives whose references and laps the figures rest on; their pictures are done with.

    Raises:
        InputError: one of them cannot be right, and not `force`.
    """
    drives = {
        str(one.drive.path): one.drive
        for route in routes
        for one in route.recordings
        if one.drive is not None
    }
    for drive in drives.values():
        require_plausible(drive.name, check_drive(drive), force=force)


def _made_from(routes: Sequence[Route]) -> list[Path]:
    """The drives and maps that the runs name."""
    mains = [recording.main for route in routes for recording in route.recordings]
    return [place for main in mains for place in (main.drive, main.map) if place is not None]


def parse_added(items: Sequence[str]) -> dict[str, Path]:
    """`NAME=FILE` of every `--add`.

    Raises:
        ConfigError: not of that form, or a name twice or taken.
    """
    added: dict[str, Path] = {}
    for item in items:
        name, equals, path = item.partition("=")
        if not (name and equals and path):
            raise ConfigError(f"--add {item}: expected NAME=FILE.tum")
        if name in added or name in ("pf", "kf", "reference", "truth"):
            raise ConfigError(f"--add {item}: the name '{name}' is taken; choose another")
        added[name] = Path(path)
    return added


def parse_alignment(text: str) -> Alignment:
    """The kind of alignment that `--align` names.

    Raises:
        ConfigError: none of the known ones.
    """
    if "," in text:
        text = ",".join(sorted((part.strip() for part in text.split(",")), reverse=True))
    if text not in ALIGNMENTS:
        raise ConfigError(f"--align {text}: choose one of {'; '.join(ALIGNMENTS)}")
    return cast(Alignment, text)


def screen_table(results: Sequence[RouteResult]) -> str:
    """The headline figures for the terminal."""
    width = max(12, *(len(result.route.name) for result in results))
    head = (
        f"{'route':{width}}  {'system':12}  {'repeatability':>15}  {'lateral RMSE':>14}  laps  runs"
    )
    lines = [head]
    for result in results:
        laps = max((len(stretch.passes) for stretch in result.stretches), default=1)
        for one in result.systems:
            errors = [run.get("lateral_rmse_m", nan) for run in one.accuracy if run]
            lateral = _mean_m(errors)
            repeated = f"{one.sd_m:.3f} m" if one.sd_m == one.sd_m else "-"
            lines.append(
                f"{result.route.name:{width}}  {one.system.name:12}  {repeated:>15}  "
                f"{lateral:>14}  {laps:4d}  {len(one.repeatability):4d}"
            )
    return "\n".join(lines)


def _mean_m(errors: Sequence[float]) -> str:
    mean = sum(errors) / len(errors) if errors else nan
    return f"{mean:.3f} m" if isfinite(mean) else "-"
