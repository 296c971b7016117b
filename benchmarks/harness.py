"""What all benchmarks share: where recordings lie, fair timing, figures, and their file.

A benchmark is a module in the folder of its room with
`run() -> {name: {"median_ms": ..., "p95_ms": ..., "ratio_to_...": ...}}`. It measures what it
compares in one run, interleaved, so that a busy machine slows both sides; where the recordings that
it needs are missing it leaves out what needs them.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

FOLDER = Path(__file__).resolve().parent
# recordings lie beside the project; what is not there is left out
RECORDINGS = FOLDER.parents[1] / "shared" / "data"

Figures = dict[str, dict[str, float]]


def modules() -> list[str]:
    """Names of the benchmarks, as in `stereo.speed`: the modules that define `run`."""
    return sorted(
        f"{path.parent.name}.{path.stem}"
        for path in FOLDER.glob("*/*.py")
        if "\ndef run(" in path.read_text(encoding="utf-8")
    )


def command_line(
    doc: str | None,
    given: Sequence[str] | None = None,
    /,
    *,
    paths: str | None = None,
    **defaults: Any,
) -> argparse.Namespace:
    """Options of a benchmark that is run by itself.

    Args:
        doc: of the module; its first line is the help.
        given: words, in place of those of the command.
        paths: name of the words without an option, taken as paths.
        defaults: by option; a default's type is that of the option, a type one without default,
            False a flag, a list any of its members.
    """
    parser = argparse.ArgumentParser(description=(doc or "").partition("\n")[0])
    if paths is not None:
        parser.add_argument(paths, nargs="*", type=Path)
    for name, default in defaults.items():
        flag = f"--{name.replace('_', '-')}"
        if default is False:
            parser.add_argument(flag, action="store_true")
        elif isinstance(default, list):
            parser.add_argument(flag, nargs="+", default=default, choices=default)
        elif isinstance(default, type):
            parser.add_argument(flag, type=default)
        else:
            kind = Path if isinstance(default, Path) else type(default)
            parser.add_argument(flag, type=kind, default=default)
    return parser.parse_args(given)


def rows_in(file: Path, *key: str) -> dict[Any, dict[str, Any]]:
    """Rows of JSON lines by the values of `key`; a line that was cut off is told and left out."""
    found: dict[Any, dict[str, Any]] = {}
    for line in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
        try:
            row = json.loads(line)
            found[tuple(row[name] for name in key)] = row
        except (ValueError, KeyError, TypeError):
            print(f"{file}: a line that is no row is left out", file=sys.stderr)
    return found


def append_row(file: Path, row: Mapping[str, Any]) -> None:
    """Add a row to JSON lines, on a line of its own also where the last one was cut off."""
    with file.open("a+b") as lines:
        if lines.tell():
            lines.seek(-1, os.SEEK_END)
            if lines.read(1) != b"\n":
                lines.write(b"\n")
        lines.write(json.dumps(row).encode() + b"\n")


def interleaved(
    work: Mapping[str, Callable[[], object]], rounds: int, warm_up: int = 0
) -> dict[str, list[float]]:
    """Seconds of each kind of work, done in turn `rounds` times after `warm_up` rounds untimed."""
    times: dict[str, list[float]] = {name: [] for name in work}
    for number in range(warm_up + rounds):
        for name, task in work.items():
            begin = time.perf_counter()
            task()
            if number >= warm_up:
                times[name].append(time.perf_counter() - begin)
    return times


def summary(times_s: Sequence[float], *more: int) -> dict[str, float]:
    """Median and 95th percentile in milliseconds, and `more` percentiles."""
    values = 1e3 * np.asarray(times_s, dtype=np.float64)
    wanted = {f"p{percent}_ms": float(np.percentile(values, percent)) for percent in (95, *more)}
    return {"median_ms": float(np.median(values)), **wanted}


def compared(times_s: Mapping[str, Sequence[float]], to: str) -> Figures:
    """The summary of each, and its median as a ratio to that of `to`."""
    base = float(np.median(times_s[to]))
    return {
        name: {**summary(values), f"ratio_to_{to}": float(np.median(values)) / base}
        for name, values in times_s.items()
    }


def show(title: str, table: Mapping[str, Mapping[str, object]]) -> None:
    """Print a table, a line a row."""
    print(f"\n{title}", flush=True)
    for name, row in table.items():
        print(f"  {name:32} " + ", ".join(f"{key} {_short(value)}" for key, value in row.items()))


def write_results(path: Path, results: Mapping[str, Any]) -> None:
    """Write JSON whole or not at all."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps(results, indent=1), encoding="utf-8")
    part.replace(path)


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def apart(work: Callable[..., Any], *arguments: Any) -> Any:
    """What a function gives in a new process: memory and caches are its own."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        return pool.submit(work, *arguments).result()
