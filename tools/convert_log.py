"""Logs of other recorders as drives, fixes and signal logs; see `tools/convert.py`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from polemap.drivelog.atomic import atomic_file, check_file, check_folder
from polemap.drivelog.errors import ConfigError, InputError, OutputError
from polemap.drivelog.logs.convert import Converted, convert_logs
from polemap.drivelog.logs.guess import guessed_mapping
from polemap.drivelog.logs.mapping import SIGNALS, LogMapping, read_log_mapping
from polemap.drivelog.logs.write import converted_folder, write_rows
from polemap.drivelog.readers.registry import open_drive
from polemap.electric.io import KNOWN
from polemap.tools.convert import Request
from polemap.tools.findings import require_plausible
from polemap.tools.plausible import find


def _inputs(request: Request) -> list[Path]:
    return [*request.inputs, *([request.mapping] if request.mapping is not None else [])]


def _converted(request: Request, name: str) -> Converted:
    mapping = LogMapping(str(request.inputs[0]))
    if request.mapping is not None:
        mapping = read_log_mapping(request.mapping, KNOWN)
    return convert_logs(
        request.inputs, mapping, name=name, wheelbase_m=request.wheelbase_m, day=request.day
    )


def write_mapping(inputs: Sequence[Path], out: Path, given: Path | None) -> list[str]:
    """A mapping of logs to complete, from what their headers and first rows show."""
    mapping = LogMapping(str(out)) if given is None else read_log_mapping(given, KNOWN)
    check_file(out, [*inputs, given])
    if out.exists():
        raise OutputError(f"{out}: is there already; give another name, or delete it")
    text, open_choices = guessed_mapping(inputs, mapping)
    with atomic_file(out, inputs) as part:
        part.write_text(text, encoding="utf-8")
    many = f"{open_choices} value{'s say' if open_choices != 1 else ' says'}"
    left = f"{many} CHOOSE" if open_choices else "look it through"
    names = " ".join(str(path) for path in inputs)
    return [
        f"{out}: {left}; then",
        f"next: polemap convert {names} --mapping {out} --out DRIVE",
    ]


def to_folder(request: Request) -> list[str]:
    """A plain drive folder of logs, if what it says can be right."""
    check_folder(request.out, "drive", _inputs(request))
    made = _converted(request, Path(os.path.realpath(request.out)).name)
    if set(made.streams) == {SIGNALS}:
        raise ConfigError(
            f"convert: the mapping has signals alone, which are no drive; --out {request.out}.csv "
            "writes a log for polemap estimate"
        )
    if "vehicle" not in made.head:
        raise InputError(
            f"{request.inputs[0]}: a drive needs the car's wheelbase; add --wheelbase 2.71 or "
            "`drive: {vehicle: {wheelbase_m: 2.71}}` to the mapping"
        )
    with converted_folder(made, request.out, _inputs(request)) as folder:
        drive = open_drive(folder)
        require_plausible(request.out.name, find(drive), force=request.force)
    return [
        *made.says,
        *(f"note: {note}" for note in drive.notes),
        f"drive {drive.name}: {drive.duration_s:.1f} s in {drive.frame}, written to {request.out}",
        f"next: polemap info {request.out}",
    ]


def to_csv(request: Request) -> list[str]:
    """A signal log where the mapping has one, else the fixes as gnss.csv."""
    check_file(request.out, _inputs(request), (".csv",))
    made = _converted(request, request.out.stem)
    key = SIGNALS if SIGNALS in made.streams else "gnss"
    if key not in made.streams:
        raise ConfigError(
            f"convert: --out {request.out} is for signals or fixes, and the mapping has neither; "
            "name a folder"
        )
    with atomic_file(request.out, _inputs(request)) as part:
        write_rows(made.streams[key], part)
    what = "signals, for polemap estimate" if key == SIGNALS else "fixes, for a gnss.csv"
    return [*made.says, f"{what}: written to {request.out}"]
