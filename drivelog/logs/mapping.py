"""The mapping file: which columns of a logger's files are which of ours, and how they are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from polemap.drivelog.errors import InputError
from polemap.drivelog.logs.column_parts import Lever, Stamps, Value, Where
from polemap.drivelog.logs.format_part import FormatPart
from polemap.drivelog.logs.units import factor, nearest_unit, units_for
from polemap.drivelog.problems import CHOOSE, did_you_mean, refusal, validation_mistakes
from polemap.drivelog.readers.drive_yaml import DriveYaml
from polemap.parsing.errors import named
from polemap.parsing.yaml_text import read_yaml

SIGNALS = "signals"
# columns that a stream must have, and those that it may have
STREAMS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "frames": (("left", "right"), ("arrival_s",)),
    "odometry": (("speed_mps", "yaw_rate_radps"), ("arrival_s",)),
    "gnss": ((), ("latitude_deg", "longitude_deg", "east_m", "north_m", "hdop", "arrival_s")),
    "reference": (("yaw_rad",), ("latitude_deg", "longitude_deg", "east_m", "north_m", "sd_m")),
    "poles": (
        ("x_m", "y_m", "var_x_m2", "var_y_m2", "cov_xy_m2"),
        ("width_m", "probability", "arrival_s"),
    ),
    "scans": ((), ()),
}
TEXTS = ("left", "right")
TIMES = ("arrival_s", "camera_arrival_s", "gnss_arrival_s")
HEADINGS = ("yaw_rad", "heading_rad", "course_rad")
_OF_STREAM = ("file", "stamp_s", "where", "measured_at", "date")
M = TypeVar("M", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class StreamPart:
    """One of our files: where its rows come from, and its columns by our names."""

    name: str
    file: str | None = None
    stamp_s: Stamps | None = None
    where: Where | None = None
    measured_at: Lever | None = None
    date: str | None = None
    values: Mapping[str, Value] = field(default_factory=dict)
    times: Mapping[str, Stamps] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LogMapping:
    """All of a mapping file.

    Attributes:
        place: the file, for messages.
        drive: what is to stand in drive.yaml; name, version and frame may be absent.
        layout: of all logs.
        layouts: of single logs, by name or pattern.
        streams: by name.
    """

    place: str
    drive: Mapping[str, Any] = field(default_factory=dict)
    layout: FormatPart = field(default_factory=FormatPart)
    layouts: Mapping[str, FormatPart] = field(default_factory=dict)
    streams: Mapping[str, StreamPart] = field(default_factory=dict)


def read_log_mapping(path: Path, signals: Sequence[str]) -> LogMapping:
    """Read and check a mapping file.

    Args:
        path: the YAML file.
        signals: columns of a signal log, which the section `signals` may have.

    Raises:
        InputError: unreadable, or wrong in one place; in several, all of them as `Mistakes`.
    """
    with named(path, InputError, "mapping file"):
        tree = read_yaml(path)
    if not isinstance(tree, dict) or not tree:
        raise InputError(
            f"{path}: a mapping file has sections such as `odometry:`; `polemap convert LOG "
            "--write-mapping MAP.yaml` writes one to complete"
        )
    open_choices = [f"{key}: still says {CHOOSE}; {_remedy(key)}" for key in _open_choices(tree)]
    known = ("drive", "format", "formats", *STREAMS, SIGNALS)
    wrong = [
        f"{key}: unknown section; known: {', '.join(known)}{did_you_mean(str(key), known)}"
        for key in tree
        if key not in known
    ]
    drive = _drive(path, tree.get("drive"), wrong)
    layout = _checked(FormatPart, tree.get("format") or {}, "format", wrong) or FormatPart()
    layouts = {}
    for name, part in (tree.get("formats") or {}).items():
        layouts[str(name)] = _checked(FormatPart, part, f"formats.{name}", wrong) or FormatPart()
    streams = {}
    for name in (*STREAMS, SIGNALS):
        if name in tree:
            streams[name] = _stream(name, tree[name], signals, wrong)
    if open_choices or wrong:
        # a value that is still to be chosen may break other rules, too: it is told once
        raise refusal(path, open_choices or wrong)
    if not streams and not (set(tree) & {"drive", "format", "formats"}):
        raise InputError(f"{path}: maps no column; add a section such as `odometry:`")
    return LogMapping(str(path), drive, layout, layouts, streams)


def _open_choices(tree: Any, place: str = "") -> Iterator[str]:
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield from _open_choices(value, f"{place}.{key}" if place else str(key))
    elif isinstance(tree, list):
        for number, value in enumerate(tree):
            yield from _open_choices(value, f"{place}.{number}")
    elif tree == CHOOSE:
        yield place


def _remedy(place: str) -> str:
    key = place.rpartition(".")[2]
    return {
        "unit": "give the unit of the column",
        "column": "give the column's name or number",
        "turn": "give clockwise or counter_clockwise",
        "from": "give true_north, grid_north, true_east or grid_east",
        "wheelbase_m": "give the distance from the rear to the front axle, metres",
        "zone": "give UTC, an offset such as '+02:00', or Europe/Berlin",
    }.get(key, "give its value, or delete the line")


def _checked(model: type[M], part: Any, place: str, wrong: list[str]) -> M | None:
    try:
        return model.model_validate(part)
    except ValidationError as error:
        wrong += validation_mistakes(error, model, f"{place}.")
        return None


def _drive(path: Path, part: Any, wrong: list[str]) -> Mapping[str, Any]:
    """What is to stand in drive.yaml; a text is the path of such a file."""
    if part is None:
        return {}
    if isinstance(part, str):
        place = path.parent / part
        with named(place, InputError, "drive.yaml"):
            part = read_yaml(place)
    if not isinstance(part, dict):
        wrong.append("drive: is no section; give the keys of drive.yaml, or the path of one")
        return {}
    # what may be absent is filled in later, so that the rest can be checked now
    whole = {"format_version": 1, "name": "a", "frame": {"kind": "local", "name": "a"}, **part}
    _checked(DriveYaml, whole, "drive", wrong)
    return part


def _stream(name: str, part: Any, signals: Sequence[str], wrong: list[str]) -> StreamPart:
    required, optional = STREAMS.get(name, ((), tuple(s for s in signals if s != "stamp_s")))
    if part is None:
        part = {}
    if not isinstance(part, dict):
        wrong.append(f"{name}: is no section; give lines such as `speed_mps: {{column: v}}`")
        return StreamPart(name)
    given: dict[str, Any] = {}
    values: dict[str, Value] = {}
    times: dict[str, Stamps] = {}
    models: dict[str, type[BaseModel]] = {"stamp_s": Stamps, "where": Where, "measured_at": Lever}
    for key, value in part.items():
        place = f"{name}.{key}"
        if key in models:
            given[key] = _checked(models[key], _short(value), place, wrong)
        elif key in ("file", "date"):
            given[key] = str(value)
        elif key in TIMES and key in optional:
            stamps = _checked(Stamps, _short(value), place, wrong)
            if stamps is not None:
                times[key] = stamps
        elif key in required or key in optional:
            column = _checked(Value, _short(value), place, wrong)
            if column is not None:
                values[key] = column
                wrong += [f"{place}: {what}" for what in _value_mistakes(key, column)]
        else:
            columns = (*_OF_STREAM, *required, *optional)
            wrong.append(
                f"{place}: unknown column; known: {', '.join(columns)}"
                f"{did_you_mean(str(key), columns)}"
            )
    if "measured_at" in part and name != "reference":
        wrong.append(f"{name}.measured_at: only a reference has it; delete the line")
    return StreamPart(name, values=values, times=times, **given)


def _short(value: Any) -> Any:
    """`speed_mps: v` for `speed_mps: {column: v}`."""
    return {"column": value} if isinstance(value, str | int) else value


def _value_mistakes(name: str, value: Value) -> Iterator[str]:
    """What one column's own keys contradict."""
    units = units_for(name)
    if value.unit is not None:
        if not units:
            yield f"has no unit, and `unit: {value.unit}` stands there; delete it"
        elif factor(name, value.unit) is None:
            near = nearest_unit(name, value.unit)
            yield (
                f"'{value.unit}' is no unit for it; known: {', '.join(units)}"
                f"{f'; did you mean {near!r}?' if near else ''}"
            )
    if value.turn is not None and not name.endswith(("_rad", "_radps")):
        yield "has no turning direction; delete `turn`"
    if value.zero is not None and name not in HEADINGS:
        yield "is no heading; delete `from`"
    if name in TEXTS and value.column is None:
        yield "is a path; give its `column`"
