"""`polemap localize`: replay a drive against a map."""

from __future__ import annotations

import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from os import cpu_count
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from drivelog.atomic import atomic_folder
from drivelog.drive import Drive, open_drive
from drivelog.errors import ConfigError
from drivelog.samples import PoleScan
from localize.io import write_metrics, write_run
from localize.metrics import spread, timing_summary
from localize.replay import check_inputs, replay
from polemap import __version__
from polemap.io import read_map
from polemap.landmark_map import PoleMap
from polemap.perception import scan_drive
from tools.progress import progress
from tools.settings import ConfigOption, SeedOption, SetOption, Settings, load_settings


def command(
    drive: Annotated[Path, typer.Argument(help="Drive folder of any known kind.")],
    out: Annotated[Path, typer.Option("--out", help="Run folder to write.")],
    map_file: Annotated[
        Path | None, typer.Option("--map", help="Pole map: gpkg, geojson, parquet or csv.")
    ] = None,
    lap: Annotated[str | None, typer.Option("--lap", help="A row of laps.csv.")] = None,
    runs: Annotated[
        int, typer.Option("--runs", min=1, max=10_000, help="Monte Carlo runs, one seed each.")
    ] = 1,
    without_poles: Annotated[
        bool, typer.Option("--without-poles", help="Odometry and GNSS alone, to compare with.")
    ] = False,
    workers: Annotated[
        int | None, typer.Option("--workers", min=1, help="Processes for the runs; default: cores.")
    ] = None,
    seed: SeedOption = 0,
    config: ConfigOption = None,
    set_values: SetOption = None,
) -> None:
    """Replay a drive against a pole map: particle filter, output filter, accuracy.

    Examples:
        polemap localize drives/lap_2 --map campus.gpkg --out runs/lap_2
        polemap localize drives/lap_2 --map campus.gpkg --out runs/lap_2 --runs 20 --seed 100
        polemap localize drives/park --lap test --map park.csv --out runs/park
        polemap localize drives/lap_2 --without-poles --out runs/lap_2_dead_reckoning

    Writes pf.tum and kf.tum (100 Hz), health.csv, output.csv, metrics.json and config.yaml; with
    --runs one folder a run and the mean and spread over them. The same seed gives the same
    trajectories, bit for bit.
    """
    settings = load_settings(config, set_values)
    if (map_file is None) != without_poles:
        raise ConfigError(
            "localize needs a map: give --map MAP"
            if map_file is None
            else "--map and --without-poles exclude each other; drop one of them"
        )
    recording = _Recording(drive, lap)
    opened = recording.open(0)
    pole_map = read_map(map_file, frame=opened.frame) if map_file is not None else None
    seen = _Seen((), {}, 0.0) if pole_map is None else _look(opened, pole_map, settings)
    job = _Job(recording, pole_map, seen, settings, map_file)
    with atomic_folder(out) as folder:
        if runs == 1:
            metrics = job.run(folder, seed, show=True)
        else:
            metrics = _many(job, folder, seed, runs, min(workers or cpu_count() or 1, runs))
    typer.echo(_table(metrics, out))


@dataclass(frozen=True, slots=True)
class _Recording:
    """A drive on the disk, or a lap of it."""

    path: Path
    lap: str | None

    def open(self, seed: int) -> Drive:
        """The drive; `seed` is for sensors that it lacks and that are derived."""
        drive = open_drive(self.path, seed=seed)
        return drive if self.lap is None else drive.lap(self.lap)


@dataclass(frozen=True, slots=True)
class _Seen:
    """The poles of a drive and the time that it took to find them."""

    scans: tuple[PoleScan, ...]
    timing_ms: dict[str, dict[str, float]]
    seconds: float


class _Job:
    """All that a run needs, sent to each worker once."""

    def __init__(
        self,
        recording: _Recording,
        pole_map: PoleMap | None,
        seen: _Seen,
        settings: Settings,
        map_file: Path | None,
    ) -> None:
        self._recording, self._map, self._seen = recording, pole_map, seen
        self._settings, self._map_file = settings, map_file

    def run(self, folder: Path, seed: int, *, show: bool = False) -> dict[str, Any]:
        """One run into `folder`; its metrics."""
        seen = self._seen
        # sensors that had to be derived get noise of their own in every run
        drive = replace(self._recording.open(seed), images=None, scans=())
        total = sum(len(stream) for stream in (drive.odometry, drive.gnss) if stream is not None)
        with progress((total + len(seen.scans)) if show else None, "localizing") as advance:
            run = replay(
                drive,
                self._map,
                seen.scans,
                self._settings.localize,
                seed=seed,
                clock=time.perf_counter,
                progress=advance if show else None,
            )
        metrics = run.metrics
        metrics["timing_ms"] = {**seen.timing_ms, **metrics["timing_ms"]}
        metrics["perception_s"] = seen.seconds
        spent = seen.seconds + metrics["replay_s"]
        metrics["real_time_factor"] = drive.duration_s / spent if spent > 0 else None
        folder.mkdir(parents=True, exist_ok=True)
        write_run(folder, run, self._as_used(seed))
        return metrics

    def _as_used(self, seed: int) -> dict[str, Any]:
        return {
            "polemap_version": __version__,
            "drive": str(self._recording.path),
            "map": None if self._map_file is None else str(self._map_file),
            "lap": self._recording.lap,
            "seed": seed,
            "settings": self._settings.model_dump(mode="json"),
        }


def _look(drive: Drive, pole_map: PoleMap, settings: Settings) -> _Seen:
    """The poles of every frame, found once for all runs."""
    check_inputs(drive, pole_map, has_poles=drive.has_frames or bool(drive.scans))
    total = len(drive.frame_stamps_s) if drive.has_frames else len(drive.scans)
    moments = [time.perf_counter()]
    with progress(total, "looking for poles") as advance:

        def done(steps: int) -> None:
            moments.append(time.perf_counter())
            advance(steps)

        scans = scan_drive(drive, settings.polemap, progress=done, stereo=settings.stereo)
    timing = timing_summary({"perception": np.diff(moments).tolist()})
    return _Seen(tuple(scans), timing, moments[-1] - moments[0])


_job: _Job | None = None


def _take_job(job: _Job) -> None:
    global _job
    _job = job


def _one(folder: Path, seed: int) -> dict[str, Any]:
    if _job is None:
        raise RuntimeError("a worker was started without its job")
    return _job.run(folder, seed)


def _many(job: _Job, folder: Path, seed: int, runs: int, workers: int) -> dict[str, Any]:
    """Runs of seeds seed ... seed + runs - 1 in parallel; mean and spread of their metrics."""
    digits = max(3, len(str(runs - 1)))
    folders = [folder / f"{number:0{digits}d}" for number in range(runs)]
    results: dict[int, dict[str, Any]] = {}
    with (
        progress(runs, f"{runs} runs on {workers} processes") as advance,
        ProcessPoolExecutor(
            workers, mp_context=get_context("spawn"), initializer=_take_job, initargs=(job,)
        ) as pool,
    ):
        futures = {
            pool.submit(_one, place, seed + number): number for number, place in enumerate(folders)
        }
        try:
            for future in as_completed(futures):
                results[futures[future]] = future.result()
                advance(1)
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    ordered = [results[number] for number in range(runs)]
    metrics = {
        "runs": runs,
        "seeds": [seed, seed + runs - 1],
        "drive": ordered[0]["drive"],
        "frame": ordered[0]["frame"],
        "notes": ordered[0]["notes"],
        **spread(ordered),
    }
    write_metrics(folder / "metrics.json", metrics)
    return metrics


def _table(metrics: dict[str, Any], out: Path) -> str:
    """What the user wants to know first."""
    lines = [f"note: {note}" for note in metrics["notes"]]
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
    return "\n".join([*lines, f"wrote {out}"])


def _figure(value: Any, scale: float = 1.0, digits: int = 3) -> str:
    if isinstance(value, dict):
        return f"{value['mean'] * scale:.{digits}f} ± {value['sd'] * scale:.{digits}f}"
    return f"{value * scale:.{digits}f}"
