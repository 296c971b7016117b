"""`polemap localize`: replay a drive against a map."""

from __future__ import annotations

from os import cpu_count
from pathlib import Path
from typing import Annotated, Any

import typer

from polemap.drivelog.atomic import atomic_folder, check_folder
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import ConfigError
from polemap.evaluation.verdict import verdict_lines
from polemap.localize.config import for_car
from polemap.localize.replay import Run, check_inputs
from polemap.map.city.city_map import CityMap
from polemap.map.city.io import open_map
from polemap.map.pole_map import PoleMap
from polemap.settings import Settings, load_settings
from polemap.tools.drive_detection import DriveDetections, Source, detect_drive
from polemap.tools.findings import require_plausible
from polemap.tools.follow.command import Asked, check_options, follow
from polemap.tools.follow.option_types import (
    CarOption,
    DelayOption,
    FollowOption,
    IdleOption,
    ServeOption,
)
from polemap.tools.learn import check_learn, learn
from polemap.tools.monte_carlo import Replay, run_many, shared_runs
from polemap.tools.option_types import (
    ConfigOption,
    ForceOption,
    LapOption,
    OdometryOption,
    SeedOption,
    SetOption,
    TopicsOption,
    WorkersOption,
)
from polemap.tools.pattern_index import index_for_start
from polemap.tools.plausible import find
from polemap.tools.progress import progress


def command(
    drive: Annotated[
        Path | None, typer.Argument(help="Drive of any known kind; not with --follow.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Run folder to write; with --follow as you like.")
    ] = None,
    map_file: Annotated[
        Path | None,
        typer.Option("--map", help="Pole map: gpkg, geojson, parquet, csv, or a folder."),
    ] = None,
    lap: LapOption = None,
    runs: Annotated[
        int, typer.Option("--runs", min=1, max=10_000, help="Monte Carlo runs, one seed each.")
    ] = 1,
    without_poles: Annotated[
        bool, typer.Option("--without-poles", help="Odometry and GNSS alone, to compare with.")
    ] = False,
    workers: WorkersOption = None,
    cache: Annotated[
        Path | None,
        typer.Option("--cache", help="Keeps detections and finished runs: a killed call goes on."),
    ] = None,
    learned: Annotated[
        Path | None,
        typer.Option("--learn", help="Write a copy of the map with what the drive saw beside it."),
    ] = None,
    topics: TopicsOption = None,
    followed: FollowOption = None,
    car: CarOption = None,
    serve: ServeOption = None,
    idle_s: IdleOption = None,
    delay_s: DelayOption = None,
    odometry: OdometryOption = "auto",
    force: ForceOption = False,
    seed: SeedOption = 0,
    config: ConfigOption = None,
    set_values: SetOption = None,
) -> int:
    """Replay a drive against a pole map: particle filter, output filter, accuracy.

    Examples:
        polemap localize drives/lap_2 --map campus.gpkg --out runs/lap_2
        polemap localize drives/lap_2 --map campus.gpkg --out runs/lap_2 --runs 20 --seed 100
        polemap localize drives/park --lap test --map park.csv --out runs/park
        polemap localize drives/week --lap monday:friday --map park.csv --out runs/week --cache kept
        polemap localize drives/lap_2 --without-poles --out runs/lap_2_dead_reckoning
        polemap localize drives/lap_2 --map campus.gpkg --out runs/lap_2 --learn larger.gpkg
        polemap localize --follow recording.mcap --map campus.gpkg --car drives/lap_1
        sensors | polemap localize --follow - --map campus.gpkg --car drives/lap_1 --serve 8765

    Writes pf.tum and kf.tum (100 Hz), health.csv, output.csv, timing.csv, metrics.json and
    config.yaml; with --runs one folder a run and the mean and spread over them. The same seed gives
    the same trajectories, bit for bit. The poles are detected once, in parallel; --cache keeps
    what was found there, for other runs and for the sweeps of polemap report.

    --learn adds the poles that the map lacks to a copy of it; see docs/slam.md.

    --follow localizes while a drive is being recorded: a JSON line a pose on stdout, 100 a second,
    or --serve; see docs/live.md.
    """
    if followed is not None:
        check_options({"a drive": drive is not None, "--lap": lap is not None, "--runs": runs > 1,
                       "--cache": cache is not None, "--workers": workers is not None,
                       "--odometry": odometry != "auto",
                       "--learn": learned is not None})  # fmt: skip
        _check_map(map_file, without_poles)
        settings = load_settings(config, set_values)
        asked = Asked(
            followed, map_file, car, topics, out, serve, idle_s, delay_s or 0.0, seed, settings
        )
        return follow(asked)
    if drive is None or out is None:
        raise ConfigError("localize: DRIVE and --out are needed (or --follow SOURCE)")
    _refuse_live_options({"--car": car, "--serve": serve, "--idle": idle_s,
                          "--delay": delay_s})  # fmt: skip
    check_folder(out, "run", (drive, map_file, cache, config, topics))
    _check_map(map_file, without_poles)
    if learned is not None:
        check_learn(learned, map_file, runs, [drive, config, topics])
    settings = load_settings(config, set_values)
    processes = workers or cpu_count() or 1
    source = Source(str(drive), lap, None if topics is None else str(topics), odometry)
    opened = source.open()
    pole_map = open_map(map_file, frame=opened.frame) if map_file is not None else None
    require_plausible(opened.name, find(opened, pole_map), force=force)
    settings = settings.model_copy(update={"localize": for_car(settings.localize, opened.car)})
    detected = _detect(source, opened, pole_map, settings, processes, cache)
    index_for_start(pole_map, map_file, opened, processes)
    job = Replay(source, map_file, pole_map, detected, settings, opened.frame)
    kept = None if cache is None or runs == 1 else cache / f"runs-{job.key(opened)}"
    found_runs: list[Run] = []
    with shared_runs(kept), atomic_folder(out, "run") as folder:
        if runs == 1:
            metrics = job.run(folder, seed, show=True, found=found_runs.append)
        else:
            metrics = run_many(job, folder, seed, runs, min(processes, runs), kept)
    if learned is not None and map_file is not None:
        for line in learn(opened, detected.scans, found_runs[0].pf, map_file, learned, settings):
            typer.echo(line)
    typer.echo(_table(metrics, () if pole_map is None else pole_map.notes, out))
    return 0


def _refuse_live_options(given: dict[str, Any]) -> None:
    lone = next((name for name, value in given.items() if value is not None), None)
    if lone is not None:
        raise ConfigError(f"{lone} goes with --follow; drop it")


def _detect(
    source: Source,
    drive: Drive,
    pole_map: PoleMap | CityMap | None,
    settings: Settings,
    processes: int,
    cache: Path | None,
) -> DriveDetections:
    """What is seen of poles along the drive, once for all runs; nothing without a map."""
    if pole_map is None:
        return DriveDetections((), {})
    check_inputs(drive, pole_map, has_poles=drive.has_frames or bool(drive.scans))
    total = len(drive.frame_stamps_s) if drive.has_frames else len(drive.scans)
    with progress(total, "detecting poles") as advance:
        return detect_drive(source, drive, settings, processes, cache, advance)


def _check_map(map_file: Path | None, without_poles: bool) -> None:
    if (map_file is None) != without_poles:
        raise ConfigError(
            "localize needs a map: give --map MAP"
            if map_file is None
            else "--map and --without-poles exclude each other; drop one of them"
        )


def _table(metrics: dict[str, Any], map_notes: tuple[str, ...], out: Path) -> str:
    """What the user wants to know first."""
    lines = [f"note: {note}" for note in (*metrics["notes"], *map_notes)]
    for name, title in (("pf", "particle filter"), ("kf", "output filter")):
        if "lateral_rmse_m" in metrics.get(name, {}):
            row = metrics[name]
            lines.append(
                f"{title:15}  lateral {_figure(row['lateral_rmse_m'])} m, longitudinal "
                f"{_figure(row['longitudinal_rmse_m'])} m, yaw "
                f"{_figure(row['yaw_rmse_rad'], 57.29578)} deg (rms)"
            )
    lines.append(
        f"re-initializations {_figure(metrics['reinitializations'], 1, 0)}, "
        f"gate rejections {_figure(metrics['gate_rejections'], 1, 0)}"
    )
    for kind, count in metrics.get("input_problems", {}).items():
        lines.append(f"left out: {_figure(count, 1, 0)} x {kind.replace('_', ' ')}")
    ending = [f"wrote {out}", f"next: polemap report {out} --out report; polemap view {out}"]
    return "\n".join([*lines, *verdict_lines(metrics["verdict"]), *ending])


def _figure(value: Any, scale: float = 1.0, digits: int = 3) -> str:
    if isinstance(value, dict):
        return f"{value['mean'] * scale:.{digits}f} ± {value['sd'] * scale:.{digits}f}"
    return f"{value * scale:.{digits}f}"
