"""A mapping to complete: what names, units and first rows of logs show, and CHOOSE for the rest."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

from polemap.drivelog.errors import InputError
from polemap.drivelog.logs.column_parts import Stamps
from polemap.drivelog.logs.columns import stamps_wanted
from polemap.drivelog.logs.log_files import LogFile, PointLog
from polemap.drivelog.logs.mapping import HEADINGS, LogMapping
from polemap.drivelog.logs.open_logs import Logs
from polemap.drivelog.logs.units import units_for
from polemap.drivelog.problems import CHOOSE

# what loggers call our columns; matched against the words of a name, unit and case left out
_NAMES: dict[str, str] = {
    "stamp_s": r"time|timestamp|stamp|t|zeit|utc|epoch|date ?time|secs?|tow",
    "speed_mps": r"speed|velocity|vel|v|vx|v x|wheel ?speed.*|geschwindigkeit|twist.*x",
    "yaw_rate_radps": r"yaw ?rate|gyro ?z|gz|omega ?z|wz|gierrate|angular.*z|psi ?dot|r",
    "latitude_deg": r"lat|latitude|breite",
    "longitude_deg": r"lon|lng|long|longitude|laenge",
    "hdop": r"hdop",
    "east_m": r"east|easting|e|x|utm ?x|pos ?x",
    "north_m": r"north|northing|n|y|utm ?y|pos ?y",
    "yaw_rad": r"yaw|heading|psi|course|azimuth|hdg|kurs",
    "sd_m": r"sd|sigma|std|accuracy|h ?acc",
    "left": r"left.*|image ?0.*|img ?l.*|cam ?l.*",
    "right": r"right.*|image ?1.*|img ?r.*|cam ?r.*",
    "x_m": r"x|pole ?x",
    "y_m": r"y|pole ?y",
    "var_x_m2": r"var ?x.*|xx",
    "var_y_m2": r"var ?y.*|yy",
    "cov_xy_m2": r"cov ?xy.*|xy",
    "width_m": r"width|diameter",
    "road_wheel_angle_rad": r"(road )?(wheel|steer\w*)( ?wheel)?( ?angle)?|delta",
    "ax_mps2": r"ax|acc\w* ?x|a ?x",
    "ay_mps2": r"ay|acc\w* ?y|a ?y",
    "vx_mps": r"speed|velocity|vel|v|vx|v x|wheel ?speed.*",
}
# a stream is written if all of these have a candidate
_STREAMS: tuple[tuple[str, tuple[str, ...], tuple[str, ...]], ...] = (
    ("odometry", ("speed_mps", "yaw_rate_radps"), ()),
    ("gnss", ("latitude_deg", "longitude_deg"), ("hdop",)),
    ("reference", ("east_m", "north_m", "yaw_rad"), ("sd_m",)),
    ("frames", ("left", "right"), ()),
    ("poles", ("x_m", "y_m", "var_x_m2", "var_y_m2", "cov_xy_m2"), ("width_m",)),
    ("signals", ("road_wheel_angle_rad", "vx_mps"), ("yaw_rate_radps", "ax_mps2", "ay_mps2")),
)
_SHOWN_COLUMNS, _SHOWN_VALUES = 60, 3
_HEAD = """\
# Written by polemap convert --write-mapping. Give what says CHOOSE, look at the rest, delete what
# the log does not have. docs/logs.md explains every key.
"""


def guessed_mapping(paths: Sequence[Path], mapping: LogMapping) -> tuple[str, int]:
    """The text of a mapping file, and how often it says CHOOSE.

    Raises:
        InputError: a log whose layout only the user knows.
    """
    logs = Logs(paths, mapping, day="1970-01-01").files
    lines = [_HEAD, "drive:", f"  vehicle: {{wheelbase_m: {CHOOSE}}}  # rear to front axle, metres"]
    lines.append("  # frame: {kind: utm, epsg: 32632}  # where absent: the zone of the first fix")
    written: set[str] = set()
    for log in logs:
        used: set[int] = set()
        lines += ["", *_described(log)]
        if isinstance(log, PointLog):
            lines += (
                ["gnss:", f"  file: {json.dumps(log.path.name)}"] if "gnss" not in written else []
            )
            written.add("gnss")
            continue
        for name, required, optional in _STREAMS:
            found = {column: _candidates(log, column) for column in (*required, *optional)}
            if name in written or not _likely(found, required, used):
                continue
            written.add(name)
            lines += _section(log, name, {c: f for c, f in found.items() if f or c in required})
            used |= {index for columns in found.values() for index in columns}
        if not written and log is logs[-1]:
            written.add("odometry")
            lines += _section(logs[0], "odometry", {"speed_mps": [], "yaw_rate_radps": []})
        lines += _unused(log, used | set(_candidates(log, "stamp_s")))
    text = "\n".join(lines) + "\n"
    return text, text.count(CHOOSE) - _HEAD.count(CHOOSE)


def _likely(found: dict[str, list[int]], required: Sequence[str], used: set[int]) -> bool:
    """Whether a log has a stream: all that it needs, or half of it in columns for nothing else."""
    if all(found[column] for column in required):
        return True
    own = [column for column in required if set(found[column]) - used]
    return 2 * len(own) >= len(required)


def _unused(log: LogFile, used: set[int]) -> list[str]:
    """What is to be done with columns whose names say nothing."""
    left = [index for index in range(min(len(log.names), _SHOWN_COLUMNS)) if index not in used]
    if not left:
        return []
    names = ", ".join(_name(log, index) for index in left)
    return [
        f"# not used, their names tell nothing: {names}. One that is needed goes into a section:",
        f"#   speed_mps: {{column: {_name(log, left[0])}, unit: km/h}}",
        f"# sections: {', '.join(name for name, _, _ in _STREAMS)}; docs/logs.md lists columns",
    ]


def _described(log: LogFile) -> list[str]:
    lines = [f"# {log.path.name}: {log.says}"]
    count = len(log.names) or getattr(getattr(log, "layout", None), "width", 0)
    for index in range(min(count, _SHOWN_COLUMNS)):
        name = log.names[index] if log.names else ""
        lines.append(f"#   {index + 1} {name}: {', '.join(log.samples(index)[:_SHOWN_VALUES])}")
    if count > _SHOWN_COLUMNS:
        lines.append(f"#   and {count - _SHOWN_COLUMNS} columns more")
    return lines


def _candidates(log: LogFile, ours: str) -> list[int]:
    """Columns that are called as ours may be, first those of its own name."""
    exact = [i for i, name in enumerate(log.names) if name == ours]
    pattern = re.compile(_NAMES[ours])
    return exact or [i for i, name in enumerate(log.names) if pattern.fullmatch(_words(name))]


def _words(name: str) -> str:
    """`GPS.Vehicle_Speed [km/h]` as `vehicle speed`: without unit, group and signs."""
    text = re.sub(r"[\[({<].*", "", name)
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text)
    text = re.sub(r"[^A-Za-z0-9]+", " ", text).strip().lower()
    text = re.sub(r"^(gps|gnss|can|imu|ins|vehicle|car) ", "", text)
    return re.sub(r" (mps2?|kmh|kph|mph|radps|degps|dps|rad|deg|ms|us|ns|s|m|g)$", "", text)


def _section(log: LogFile, name: str, found: dict[str, list[int]]) -> list[str]:
    lines = [f"{name}:", f"  file: {json.dumps(log.path.name)}", _stamp_line(log)]
    for ours, columns in found.items():
        keys = [_column(log, columns)]
        if units_for(ours) and ours not in ("left", "right"):
            unit = log.unit(columns[0], ours) if len(columns) == 1 else None
            keys.append(f"unit: {unit or CHOOSE}")
        if ours in HEADINGS:
            keys += [f"turn: {CHOOSE}", f"from: {CHOOSE}"]
        elif ours in ("yaw_rate_radps", "road_wheel_angle_rad"):
            keys.append(f"turn: {CHOOSE}")
        several = " or ".join(_name(log, index) for index in columns) if len(columns) > 1 else ""
        hint = f"  # {several}" if several else ""
        if f"turn: {CHOOSE}" in keys:
            hint += "  # turn: clockwise or counter_clockwise"
        if ours in HEADINGS:
            hint += ", from: true_north, grid_north, true_east or grid_east"
        lines.append(f"  {ours}: {{{', '.join(keys)}}}{hint}")
    return lines


def _column(log: LogFile, columns: list[int]) -> str:
    return f"column: {_name(log, columns[0]) if len(columns) == 1 else CHOOSE}"


def _name(log: LogFile, index: int) -> str:
    """As YAML: the name, or the number where it is no name by itself."""
    name = log.names[index] if log.names else ""
    return json.dumps(name, ensure_ascii=False) if log.names.count(name) == 1 else str(index + 1)


def _stamp_line(log: LogFile) -> str:
    columns = _candidates(log, "stamp_s")
    if len(columns) != 1:
        several = " or ".join(_name(log, index) for index in columns)
        return f"  stamp_s: {{column: {CHOOSE}, unit: {CHOOSE}}}" + (
            f"  # {several}" * bool(several)
        )
    name = _name(log, columns[0])
    try:
        stamps_wanted(log, Stamps(column=columns[0] + 1))
    except InputError as error:
        key = "zone" if "zone" in str(error) else "format" if "format" in str(error) else "unit"
        return f"  stamp_s: {{column: {name}, {key}: {CHOOSE}}}  # {error}"
    unit = log.unit(columns[0], "stamp_s")
    if unit is not None:
        return f"  stamp_s: {{column: {name}, unit: {unit}}}"
    samples = log.samples(columns[0])
    zoned = samples and re.search(r"(Z|[+-]\d{2}:?\d{2})$", samples[0])
    return f"  stamp_s: {{column: {name}" + ("}" if zoned else f", zone: {CHOOSE}}}")
