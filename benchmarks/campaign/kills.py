"""`kill -9` at random moments of map, simulate, localize and report: nothing may be lost.

`python -m benchmarks.campaign.kills --kills 200`. After every kill the inputs are as they were, the
result is the whole old or the whole new one, and the workers are gone; after the next run that
ends, nothing is left of the killed ones.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks.harness import command_line
from polemap.drivelog.writers.folder import write_drive
from polemap.map.io import write_map
from tests.localize.point_drives import street_drive
from tests.process_groups import members

FEW = ["--set", "localize.particles=150"]
# where times or the machine stand, the bytes differ from run to run
_TIMED = ("metrics.json", "timing.csv", "health.csv", "report.json", "report.html", ".polemap")


@dataclass(frozen=True, slots=True)
class Command:
    """A command line that writes `out`, with results of two kinds that may stand there."""

    name: str
    words: list[str]
    out: Path


def commands(place: Path) -> list[Command]:
    """Inputs below `place/in`, and the commands that are killed."""
    made = street_drive(2, duration_s=8.0)
    drive, poles, run = place / "in" / "drive", place / "in" / "map.gpkg", place / "in" / "run"
    write_drive(made.drive, drive)
    write_map(made.pole_map, poles)
    localize = ["localize", str(drive), "--map", str(poles), *FEW]
    call([*localize, "--out", str(run)])
    out = place / "out"
    tasks = {
        "map": (["map", str(drive), "--workers", "2"], "m.gpkg"),
        "simulate": (["simulate", "park_loop", "--no-images", "--objects"], "drive"),
        "localize": ([*localize, "--runs", "4", "--workers", "2", "--cache", str(place / "cache")],
                     "run"),
        "report": (["report", str(run), "--sweep", "particles=100,120", "--sweep-runs", "1",
                    "--workers", "2"], "page"),
    }  # fmt: skip
    return [
        Command(name, [*words, "--out", str(out / name / target)], out / name / target)
        for name, (words, target) in tasks.items()
    ]


def line(words: list[str]) -> list[str]:
    return [sys.executable, "-m", "polemap", *words]


def call(words: list[str]) -> None:
    """Run a command to its end.

    Raises:
        RuntimeError: it did not end well.
    """
    done = subprocess.run(line(words), capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{words}: {done.returncode}: {done.stderr}")


def contents(path: Path) -> dict[str, str]:
    """Hashes of all files; only the names of those that hold times."""
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
    return {
        str(file.relative_to(path)): ""
        if file.name in _TIMED
        else hashlib.sha256(file.read_bytes()).hexdigest()
        for file in files
        if "cache" not in file.relative_to(path).parts
    }


def killed(command: Command, delay_s: float) -> int:
    """Start it, kill it after a while; the number of its processes that stay for 30 seconds."""
    process = subprocess.Popen(
        line(command.words), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        start_new_session=True,
    )  # fmt: skip
    try:
        process.wait(delay_s)
    except subprocess.TimeoutExpired:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    deadline = time.monotonic() + 30.0
    while (left := members(process.pid)) and time.monotonic() < deadline:
        time.sleep(0.1)
    return len(left)


def leftovers(folder: Path) -> list[str]:
    return sorted(str(p) for p in folder.rglob("*") if p.name.endswith((".part", ".kept")))


def campaign(kills: int, seed: int, say: Callable[[str], None]) -> dict[str, object]:
    """Kill, look, and finish with a run of every command that ends."""
    draws = random.Random(seed)
    wrong: list[str] = []
    count: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="kills-") as folder:
        place = Path(folder)
        todo = commands(place)
        whole, takes_s = {}, {}
        for command in todo:
            begin = time.monotonic()
            call(command.words)
            takes_s[command.name] = time.monotonic() - begin
            whole[command.name] = contents(command.out)
        inputs = contents(place / "in")
        for number in range(kills):
            command = todo[number % len(todo)]
            stayed = killed(command, draws.uniform(0.0, 1.1 * takes_s[command.name]))
            count[command.name] += 1
            if stayed:
                wrong.append(f"{command.name}: {stayed} processes stayed")
            if not command.out.exists() or contents(command.out) != whole[command.name]:
                wrong.append(f"{command.name}: the result is neither the old nor the new one")
            if contents(place / "in") != inputs:
                wrong.append(f"{command.name}: an input changed")
            if wrong:
                say(wrong[-1])
        for command in todo:
            call(command.words)
            if contents(command.out) != whole[command.name]:
                wrong.append(f"{command.name}: the run after the kills differs")
        wrong += [f"left behind: {path}" for path in leftovers(place)]
    return {"kills": sum(count.values()), "by_command": dict(count), "wrong": wrong}


def main() -> int:
    """Command line."""
    chosen = command_line(__doc__, kills=200, seed=0)
    result = campaign(chosen.kills, chosen.seed, print)
    print(json.dumps(result, indent=1))
    return 1 if result["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
