"""From logs and a mapping to the tables of a drive: the whole way on one screen.

`LogMapping` and files -> `LogFile` of each -> `Rows` of each stream -> drive.yaml, CSV, pictures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.logs.log_files import PointLog
from polemap.drivelog.logs.mapping import HEADINGS, SIGNALS, LogMapping, StreamPart
from polemap.drivelog.logs.open_logs import Logs
from polemap.drivelog.logs.placing import headings, place_stream, utm_zone
from polemap.drivelog.logs.rows import Rows
from polemap.drivelog.logs.streams import read_stream
from polemap.drivelog.problems import Gathered

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Converted:
    """Tables of a drive, and what is to be said of them.

    Attributes:
        head: what stands in drive.yaml.
        streams: rows by stream; of gnss in degrees where the frame is a UTM zone.
        pictures: left and right file of each row of `frames`.
        says: how each log was read, and what became of its rows, a line each.
    """

    head: Mapping[str, Any]
    streams: Mapping[str, Rows]
    pictures: Sequence[tuple[Path, Path]]
    says: Sequence[str]


def convert_logs(
    paths: Sequence[Path],
    mapping: LogMapping,
    *,
    name: str,
    wheelbase_m: float | None = None,
    day: str | None = None,
) -> Converted:
    """Tables of a drive from logs.

    Args:
        paths: the logs.
        mapping: what their columns are; NMEA and GPX need no section for gnss.
        name: of the drive, where the mapping gives none.
        wheelbase_m: likewise.
        day: of NMEA logs that say none, such as 2024-05-31.

    Raises:
        InputError: whatever cannot be read or is left open; several things as `Mistakes`.
    """
    logs = Logs(paths, mapping, day)
    parts = dict(mapping.streams)
    if "gnss" not in parts and any(isinstance(log, PointLog) for log in logs.files):
        parts["gnss"] = StreamPart("gnss")
    if not parts:
        raise InputError(
            f"{paths[0]}: no mapping says what its columns are; `polemap convert {paths[0].name} "
            "--write-mapping MAP.yaml` writes one to complete, then add --mapping MAP.yaml"
        )
    gathered = Gathered()
    streams = {key: gathered.attempt(_stream, part, logs) for key, part in parts.items()}
    if gathered.errors:
        raise gathered.error(mapping.place)
    rows = {key: found for key, found in streams.items() if found is not None}
    for key, one in rows.items():
        if not len(one.columns["stamp_s"]):
            lost = ", ".join(f"{count} {why}" for why, count in one.dropped.items())
            raise InputError(
                f"{mapping.place}: {key}: none of {one.rows_read} rows can be used "
                f"({lost or 'the log is empty'}); mend its columns, or delete the section"
            )
    pictures = _pictures(rows, logs, parts)
    head = {"format_version": 1, "name": name, **mapping.drive}
    if wheelbase_m is not None:
        head.setdefault("vehicle", {"wheelbase_m": wheelbase_m})
    if set(rows) != {SIGNALS}:
        head["frame"] = mapping.drive.get("frame") or utm_zone(rows, paths[0])
        frame = EarthFrame.from_dict(head["frame"])
        for key in ("gnss", "reference"):
            if key in rows:
                gathered.at(str(paths[0]), place_stream, parts[key], rows[key], frame)
    for column in HEADINGS:
        if SIGNALS in rows and column in rows[SIGNALS].columns:
            angles = rows[SIGNALS].numbers(column)
            rows[SIGNALS].columns[column] = headings(parts[SIGNALS], column, angles, None, None)
    if gathered.errors:
        raise gathered.error(mapping.place)
    return Converted(head, rows, pictures, _says(logs, rows))


def _stream(part: StreamPart, logs: Logs) -> Rows:
    points = part.name == "gnss"
    main = logs.named(part.name, part.file, points=points)
    others = {}
    for column, value in part.values.items():
        if value.file is not None:
            place = f"{part.name}.{column}"
            others[column] = logs.named(place, value.file, points=points)[0]
    return read_stream(part, main, others)


def _pictures(
    rows: Mapping[str, Rows], logs: Logs, parts: Mapping[str, StreamPart]
) -> list[tuple[Path, Path]]:
    """Files of the pairs; paths count from the folder of the log that lists them.

    Raises:
        InputError: the first that is missing.
    """
    if "frames" not in rows:
        return []
    folder = logs.named("frames", parts["frames"].file, points=False)[0].path.parent
    columns = rows["frames"].columns
    pairs = [
        (folder / str(left), folder / str(right))
        for left, right in zip(columns["left"], columns["right"], strict=True)
    ]
    for pair in pairs:
        for path in pair:
            if not path.is_file():
                raise InputError(f"{path}: the picture that the log lists is missing")
    return pairs


def _says(logs: Logs, rows: Mapping[str, Rows]) -> list[str]:
    lines = [f"{log.path.name}: {log.says}" for log in logs.files]
    lines += [
        f"{log.path.name}: no stream of the mapping uses it"
        for log in logs.files
        if log.path not in logs.used
    ]
    for key, one in rows.items():
        lost = ", ".join(f"{count} {why}" for why, count in sorted(one.dropped.items()) if count)
        kept = len(one.columns["stamp_s"])
        lines.append(
            f"{key}: {kept} rows of {one.rows_read} read" + (f"; left out: {lost}" if lost else "")
        )
        lines += [f"{key}: {note}" for note in one.notes]
    return lines
