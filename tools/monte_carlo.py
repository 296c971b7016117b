"""Replays of one drive with many seeds, in parallel, and resumable where a cache is given."""

from __future__ import annotations

import hashlib
import math
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from polemap import __version__
from polemap.drivelog.atomic import atomic_folder, copy_folder, reserved
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.jobs import LocalWorkers, run_jobs
from polemap.evaluation.run_metrics import run_metrics, spread, timing_summary
from polemap.evaluation.verdict import judge
from polemap.localize.io import write_metrics, write_run
from polemap.localize.replay import Run, replay
from polemap.map.city.city_map import CityMap
from polemap.map.files.io import map_files
from polemap.map.pole_map import PoleMap
from polemap.parsing.errors import named
from polemap.parsing.json_text import read_json
from polemap.settings import Settings
from polemap.tools.detection_cache import drive_fingerprint, fingerprint
from polemap.tools.drive_detection import DriveDetections, Source
from polemap.tools.machine import describe_machine
from polemap.tools.progress import progress

# what a verdict may say, from good to bad
TRUST = ("trustworthy", "partly", "not")


@dataclass(frozen=True, slots=True)
class Replay:
    """All that a run needs, sent to each worker once."""

    source: Source
    map_file: Path | None
    pole_map: PoleMap | CityMap | None
    detected: DriveDetections
    settings: Settings
    frame: EarthFrame

    def run(
        self,
        folder: Path,
        seed: int,
        *,
        show: bool = False,
        found: Callable[[Run], None] = lambda _run: None,
    ) -> dict[str, Any]:
        """One run into `folder`; its metrics. `found` is given what the replay gave."""
        # sensors that had to be derived get noise of their own in every run
        drive = replace(self.source.open(seed), images=None, scans=())
        detected = self.detected
        total = sum(len(stream) for stream in (drive.odometry, drive.gnss) if stream is not None)
        bar = progress(total + len(detected.scans), "localizing") if show else nullcontext()
        with bar as advance:
            run = replay(
                drive,
                self.pole_map,
                detected.scans,
                self.settings.localize,
                seed=seed,
                clock=time.perf_counter,
                progress=advance,
            )
        found(run)
        metrics = run_metrics(run, drive, self.pole_map)
        metrics["verdict"] = judge(run, drive, self.pole_map, self.settings.localize.gnss)
        spent = detected.total_s()
        metrics["timing_ms"] = {**timing_summary(spent), **metrics["timing_ms"]}
        metrics["machine"] = describe_machine()
        metrics["perception_s"] = sum(spent["perception"])
        busy_s = metrics["perception_s"] + metrics["replay_s"]
        metrics["real_time_factor"] = drive.duration_s / busy_s if busy_s > 0 else None
        folder.mkdir(parents=True, exist_ok=True)
        write_run(folder, run, metrics, self._as_used(seed), detected.spent_s)
        return metrics

    def key(self, drive: Drive) -> str:
        """What identifies a run but for its seed."""
        map_file = self.map_file
        return fingerprint(
            drive_fingerprint(drive),
            None if map_file is None else _digest(map_file),
            {name: value for name, value in self._as_used(0).items() if name != "seed"},
        )

    def _as_used(self, seed: int) -> dict[str, Any]:
        return {
            "polemap_version": __version__,
            "drive": self.source.drive,
            **({"topics": self.source.topics} if self.source.topics else {}),
            "map": None if self.map_file is None else str(self.map_file),
            "lap": self.source.lap,
            "odometry": self.source.odometry,
            "frame": self.frame.to_dict(),
            "seed": seed,
            "settings": self.settings.model_dump(mode="json"),
        }


def _digest(path: Path) -> str:
    """Of a file, or of all map files of a folder."""
    files = map_files(path) or [path]
    digests = []
    for file in files:
        with file.open("rb") as stream:
            digests.append(hashlib.file_digest(stream, "sha256").hexdigest())
    return "".join(digests)


@dataclass(frozen=True, slots=True)
class RunJob:
    """One run of a replay, to be kept at `target`."""

    target: str
    seed: int


@contextmanager
def shared_runs(kept: Path | None) -> Iterator[None]:
    """Holds the finished runs of a cache: for one command at a time, and until its result stands.

    Raises:
        OutputError: another process works on the same runs now.
    """
    if kept is None:
        yield
        return
    with reserved(kept):
        yield
        shutil.rmtree(kept, ignore_errors=True)


def run_many(
    job: Replay, folder: Path, seed: int, runs: int, workers: int, kept: Path | None
) -> dict[str, Any]:
    """Runs of seeds seed ... seed + runs - 1 into `folder`; mean and spread of their metrics.

    Args:
        kept: runs are finished here first and copied at the end, so that a killed call goes on;
            `shared_runs` holds and removes it.
    """
    digits = max(3, len(str(runs - 1)))
    names = [f"{number:0{digits}d}" for number in range(runs)]
    places = [folder / name if kept is None else kept / str(seed + n)
              for n, name in enumerate(names)]  # fmt: skip
    jobs = [RunJob(str(place), seed + number) for number, place in enumerate(places)]
    with progress(runs, f"{runs} runs on {workers} processes") as advance:
        run_jobs(
            jobs,
            do_run,
            LocalWorkers(workers, _take_job, (job,)),
            done=lambda one: kept is not None and Path(one.target).is_dir(),
            advance=advance,
        )
    if kept is not None:
        for place, name in zip(places, names, strict=True):
            copy_folder(place, folder / name)
    ordered = [_read_metrics(place / "metrics.json") for place in places]
    metrics = {
        "runs": runs,
        "seeds": [seed, seed + runs - 1],
        **{name: ordered[0][name] for name in ("drive", "frame", "notes")},
        **spread(ordered),
    }
    words = [run["verdict"]["trust"] for run in ordered]
    worst = max(words, key=TRUST.index)
    said = next(run["verdict"]["sentence"] for run in ordered if run["verdict"]["trust"] == worst)
    counted = ", ".join(f"{words.count(word)} {word}" for word in dict.fromkeys(words))
    metrics["verdict"] |= {"trust": worst, "sentence": f"{said} (runs: {counted})"}
    write_metrics(folder / "metrics.json", metrics)
    return metrics


_job: Replay | None = None


def _take_job(job: Replay) -> None:
    global _job
    _job = job


def do_run(one: RunJob) -> None:
    """One run of the replay that this process was given."""
    if _job is None:
        raise RuntimeError("a worker was started without its replay")
    with atomic_folder(Path(one.target), "run") as part:
        _job.run(part, one.seed)


def _read_metrics(path: Path) -> dict[str, Any]:
    """The metrics of a run; what JSON has as null was a number that is not finite.

    Raises:
        InputError: damaged, as a run that was kept may be by now.
    """

    def back(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: back(item) for key, item in value.items()}
        return math.nan if value is None else value

    with named(path, InputError, "metrics of a run"):
        tree = read_json(path)
    verdict = tree.get("verdict") if isinstance(tree, dict) else None
    whole = isinstance(verdict, dict) and verdict.get("trust") in TRUST and "sentence" in verdict
    if not whole or not {"drive", "frame", "notes"} <= tree.keys():
        raise InputError(
            f"{path}: is not the metrics of a run; delete {path.parent} and start anew"
        )
    metrics: dict[str, Any] = back(tree)
    return metrics
