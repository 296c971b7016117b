"""What `polemap info` prints of a recording, and the mapping that it writes."""

from __future__ import annotations

from math import isfinite
from pathlib import Path

import yaml

from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.readers.bags.guess import Guess
from polemap.drivelog.readers.bags.index import LogIndex, Topic
from polemap.drivelog.readers.bags.mapping import Mapping

_HEADER = """\
# Which topics of {log} are what; used with --topics. A part that is left out is guessed,
# one that is null is not used. docs/recordings.md lists all keys.
"""
# what a recording cannot say; written so that it is seen, and commented out until it is known
_HINTS = """\
# vehicle: {wheelbase_m: 2.7, base_frame: base_link, rear_axle_x_m: 0.0, base_above_ground_m: 0.0}
# camera.vehicle_from_camera: {x_m: 1.9, y_m: 0.15, z_m: 1.3, roll_rad: 0, pitch_rad: 0, yaw_rad: 0}
# odometry: {speed: {topic: /joints, fields: ["velocity[2]"], unit: rad/s}, wheel_radius_m: 0.31}
# gnss.antenna: {x_m: 0.0, y_m: 0.0}
# reference.origin: {east_m: 458000.0, north_m: 5430000.0, yaw_rad: 0.0}
# frame: {kind: utm, epsg: 32632}
"""


def describe_topics(index: LogIndex, made: Guess) -> list[str]:
    """A line a topic: name, type, count, rate, span and what it is used for."""
    kinds = sorted({container.kind for container in index.containers})
    size = sum(container.path.stat().st_size for container in index.containers)
    lines = [
        f"log        {len(index.containers)} file{'s' * (len(index.containers) > 1)} of "
        f"{', '.join(kinds)}, {size / 1e6:.1f} MB, {index.span_s:.1f} s, compression "
        f"{', '.join(index.compression) or 'none'}"
    ]
    rows = [_row(topic, made.uses.get(name, "")) for name, topic in index.topics.items()]
    widths = [max(len(row[column]) for row in rows) for column in range(5)] if rows else []
    for name, kind, count, rate, span, use in rows:
        lines.append(
            f"  {name:<{widths[0]}}  {kind:<{widths[1]}}  {count:>{widths[2]}}  "
            f"{rate:>{widths[3]}}  {span:>{widths[4]}}  {use}"
        )
    for name, topic in index.topics.items():
        if topic.other_types:
            lines.append(
                f"note       {name} was recorded as {', '.join(topic.other_types)}, too: only its "
                f"{topic.channel.type_name} messages are read"
            )
        if topic.undecodable:
            lines.append(
                f"note       {name}: {topic.undecodable} messages cannot be read "
                f"({topic.reason[:100]})"
            )
    return lines


def _row(topic: Topic, use: str) -> tuple[str, ...]:
    rate = topic.rate_hz()
    return (
        topic.name,
        topic.channel.type_name or "no schema",
        str(topic.count),
        f"{rate:.1f} Hz" if isfinite(rate) else "-",
        f"{(topic.last_log_ns - topic.first_log_ns) * 1e-9:.1f} s",
        use,
    )


def write_mapping(mapping: Mapping, log: Path, path: Path) -> None:
    """Write the mapping that a recording is read by, for a user to change."""
    values = mapping.model_dump(mode="json", exclude_defaults=True)
    values = {"format_version": 1, **values}
    with atomic_file(path) as part:
        part.write_text(
            _HEADER.format(log=log.name)
            + yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
            + _HINTS,
            encoding="utf-8",
        )
