"""`polemap localize --follow`: opens the stream, runs the engine, says what happened."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

import typer

from polemap import __version__
from polemap.drivelog.atomic import atomic_folder, check_folder
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import ConfigError, InputError
from polemap.drivelog.live.growing import GrowingBytes
from polemap.evaluation.run_metrics import run_metrics
from polemap.evaluation.verdict import judge, verdict_lines
from polemap.localize.io import write_run
from polemap.localize.replay import Run
from polemap.map.city.city_map import CityMap
from polemap.map.city.io import open_map
from polemap.map.pole_map import PoleMap
from polemap.settings import Settings
from polemap.tools import interrupts
from polemap.tools.follow.address import parse_address
from polemap.tools.follow.engine import Engine, Tick
from polemap.tools.follow.lines import tick_line
from polemap.tools.follow.source import Followed, open_followed
from polemap.tools.machine import describe_machine

# how often the same complaint is repeated
_PATIENCE_S = 5.0


@dataclass(frozen=True, slots=True)
class Asked:
    """What `localize --follow` was called with.

    Attributes:
        source: a file, or - for standard input.
        serve: `[HOST:]PORT` of a Foxglove WebSocket in place of lines on stdout.
        delay_s: answers are for so long ago, see `Engine`.
        idle_s: ends when a file has not grown for so long; None never.
    """

    source: str
    map_file: Path | None
    car: Path | None
    topics: Path | None
    out: Path | None
    serve: str | None
    idle_s: float | None
    delay_s: float
    seed: int
    settings: Settings


def follow(asked: Asked) -> int:
    """Localize a stream until it ends or is interrupted; the exit code.

    Raises:
        PolemapError: stream, map, car or place to write cannot be used.
    """
    named = (asked.map_file, asked.car, asked.topics)
    if asked.out is not None:
        check_folder(asked.out, "run", (*named, None if asked.source == "-" else asked.source))
    if asked.source != "-" and not Path(asked.source).is_file():
        raise InputError(f"{asked.source}: no such file to follow; - follows standard input")
    if asked.serve is not None:
        parse_address(asked.serve)
    stop = Event()
    with interrupts.asked_to_end(stop):
        source = GrowingBytes(asked.source, stop, asked.idle_s)
        followed = open_followed(source, asked.car, asked.topics)
        pole_map = _map(asked.map_file, followed.car)
        engine = Engine(followed, pole_map, asked.settings, asked.seed, asked.delay_s)
        for note in (*followed.car.notes, *followed.notes):
            _say(f"note: {note}")
        with ExitStack() as stack:
            send = _sender(asked, followed, pole_map, stack, stop)
            watch = _Watch(engine, followed)
            engine.run(stop, send, watch)
            watch()  # of what came last, too
        run, drive = engine.run_so_far()
        _finish(asked, run, drive, pole_map, followed)
        code = interrupts.exit_code()
        if code in (None, 130):  # Ctrl-C is how following ends
            interrupts.forget()
            return 0
        return code or 0


def _map(path: Path | None, car: Drive) -> PoleMap | CityMap | None:
    if path is None:
        return None
    pole_map = open_map(path, frame=car.frame)
    if not len(pole_map):
        raise InputError(f"{path}: holds no poles; build it from a drive that saw some")
    return pole_map


def _sender(
    asked: Asked,
    followed: Followed,
    pole_map: PoleMap | CityMap | None,
    stack: ExitStack,
    stop: Event,
) -> Callable[[Tick], None]:
    frame = followed.car.frame
    if asked.serve is None:

        def write(tick: Tick) -> None:
            if stop.is_set():
                return
            try:
                sys.stdout.write(tick_line(tick, frame))
                sys.stdout.flush()
            except OSError as error:
                # what is still in the buffer would be tried, and complained about, once more
                os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
                stop.set()
                _say(f"stdout cannot be written any more ({error.strerror}): ending")

        return write
    from polemap.tools.follow.server import FoxgloveServer

    server = FoxgloveServer(parse_address(asked.serve), frame, pole_map)
    stack.callback(server.close)
    stack.callback(lambda: _say_counts(server.counts))
    _say(f"serving {server.url}; in Foxglove: Open connection, Foxglove WebSocket")
    return server.send


class _Watch:
    """Says on stderr what changes: a position is known, frames are skipped, lines are unusable."""

    def __init__(self, engine: Engine, followed: Followed) -> None:
        self._engine, self._followed = engine, followed
        self._said_s = float("-inf")
        self._skipped = 0
        self._told: set[str] = set()

    def __call__(self) -> None:
        for kind, reason in list(self._followed.reasons.items()):
            if kind not in self._told:
                self._told.add(kind)
                _say(f"note: left out from now on, {kind.replace('_', ' ')}; the first: {reason}")
        skipped, now = self._engine.counts["frames_skipped"], time.monotonic()
        if skipped > self._skipped and now - self._said_s > _PATIENCE_S:
            self._said_s = now
            spent = self._engine.perception_s
            _say(
                f"behind: {skipped - self._skipped} frames skipped ({skipped} in all); a frame "
                f"takes {spent:.2f} s"
            )
            self._skipped = skipped


def _finish(
    asked: Asked, run: Run, drive: Drive, pole_map: PoleMap | CityMap | None, followed: Followed
) -> None:
    """The summary of `polemap localize`, on stderr, and the run folder where it was asked for."""
    if not len(run.kf):
        _say_counts(drive.problems)
        _say("no position was known at any time: nothing to sum up")
        return
    metrics: dict[str, Any] = run_metrics(run, drive)
    metrics["verdict"] = judge(run, drive, pole_map, asked.settings.localize.gnss)
    metrics["machine"] = describe_machine()
    if asked.out is not None:
        with atomic_folder(asked.out, "run") as folder:
            write_run(folder, run, metrics, _config(asked, followed.car))
    begin, end = run.kf.stamp_s[0], run.kf.stamp_s[-1]
    _say(f"{len(run.kf)} poses over {end - begin:.1f} s, {len(run.pf)} of them from poles")
    _say_counts(drive.problems)
    for line in verdict_lines(metrics["verdict"]):
        _say(line)
    if asked.out is not None:
        _say(f"wrote {asked.out}; next: polemap view {asked.out}")


def _config(asked: Asked, car: Drive) -> dict[str, Any]:
    return {
        "polemap_version": __version__,
        "drive": None if asked.source == "-" else asked.source,
        "map": None if asked.map_file is None else str(asked.map_file),
        "lap": None,
        "frame": car.frame.to_dict(),
        "seed": asked.seed,
        "settings": asked.settings.model_dump(mode="json"),
        "followed": True,
    }


def _say_counts(counts: Any) -> None:
    known = {kind: count for kind, count in counts.items() if count}
    if known:
        words = ", ".join(f"{count} {kind.replace('_', ' ')}" for kind, count in known.items())
        _say(f"counted: {words}")


def _say(text: str) -> None:
    with suppress(OSError):  # nobody reads stderr; the poses go on
        typer.echo(f"polemap: {text}", err=True)


def check_options(asked: dict[str, Any]) -> None:
    """Refuse options of a recorded drive: `asked` has their names and whether they were given.

    Raises:
        ConfigError: one of them was.
    """
    wrong = [name for name, given in asked.items() if given]
    if wrong:
        raise ConfigError(f"--follow and {wrong[0]} exclude each other; drop one of them")
