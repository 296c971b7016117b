"""From logs and a mapping to the tables of a drive: the whole way on one screen.

`LogMapping` and files -> `LogFile` of each -> `Rows` of each stream -> drive.yaml, CSV, pictures.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_folder
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame, geographic_from_grid, utm_frame
from polemap.drivelog.logs.gpx import read_gpx
from polemap.drivelog.logs.log_files import CsvLog, LogFile, PointLog, open_csv
from polemap.drivelog.logs.mapping import HEADINGS, SIGNALS, LogMapping, StreamPart
from polemap.drivelog.logs.nmea import looks_like_nmea, read_nmea
from polemap.drivelog.logs.streams import Rows, headings, place_reference, read_stream
from polemap.drivelog.logs.text import encoding_of, first_lines
from polemap.drivelog.problems import Gathered

Floats = NDArray[np.float64]

_FORMATS = {"_s": "%.6f", "_deg": "%.10f", "_m": "%.5f"}
_ROWS_AT_ONCE = 50_000


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


def open_log(path: Path, mapping: LogMapping, day: str | None = None) -> LogFile:
    """A log of any kind, by what stands in it.

    Raises:
        InputError: it cannot be read, or only the user knows how.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    part = next(
        (p for name, p in mapping.layouts.items() if fnmatch(path.name, name)), mapping.layout
    )
    encoding = encoding_of(path, part.encoding)
    # what is no CSV may hold bytes that are damaged
    head = first_lines(path, "latin-1" if encoding.startswith("utf-8") else encoding, 50)
    if "<gpx" in "".join(head[:20]).lower():
        return read_gpx(path)
    if looks_like_nmea(head):
        return read_nmea(path, day)
    return open_csv(path, part)


class Logs:
    """The files of one call, each opened once."""

    def __init__(self, paths: Sequence[Path], mapping: LogMapping, day: str | None) -> None:
        gnss = mapping.streams.get("gnss")
        stated = day if gnss is None or gnss.date is None else gnss.date
        gathered = Gathered()
        opened = [gathered.attempt(open_log, path, mapping, stated) for path in paths]
        if gathered.errors:
            raise gathered.error("logs")
        self.files: list[LogFile] = [log for log in opened if log is not None]
        self.used: set[Path] = set()

    def named(self, place: str, pattern: str | None, *, points: bool) -> list[LogFile]:
        """The files that a stream or column comes from, in the order of the call.

        Args:
            place: of the mapping, for messages.
            pattern: name of a file, with `*` of its parts.
            points: whether NMEA and GPX files serve where no name is given.

        Raises:
            InputError: none, or several where one has to be named.
        """
        names = ", ".join(log.path.name for log in self.files)
        if pattern is not None:
            found = [log for log in self.files if fnmatch(log.path.name, pattern)]
            if not found:
                raise InputError(f"{place}: no log is called '{pattern}' (given: {names})")
        else:
            kinds = [PointLog, CsvLog] if points else [CsvLog, PointLog]
            for kind in kinds:
                found = [log for log in self.files if isinstance(log, kind)]
                if found:
                    break
            if len(found) > 1:
                raise InputError(
                    f"{place}: which log holds it? add `file: {found[0].path.name}` (given: "
                    f"{names}; `*` stands for any letters where a log has several parts)"
                )
        self.used |= {log.path for log in found}
        return found


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
        head["frame"] = mapping.drive.get("frame") or _zone(rows, paths[0])
        frame = EarthFrame.from_dict(head["frame"])
        for key in ("gnss", "reference"):
            if key in rows:
                gathered.at(str(paths[0]), _place, parts[key], rows[key], frame)
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


def _zone(rows: Mapping[str, Rows], path: Path) -> dict[str, Any]:
    """The UTM zone of the first fix, where the mapping names no frame.

    Raises:
        InputError: no degrees to take it from.
    """
    for key in ("gnss", "reference"):
        if (
            key in rows
            and "latitude_deg" in rows[key].columns
            and len(rows[key].columns["stamp_s"])
        ):
            latitude, longitude = (
                float(rows[key].numbers(name)[0]) for name in ("latitude_deg", "longitude_deg")
            )
            return utm_frame(latitude, longitude).to_dict()
    raise InputError(
        f"{path}: no latitudes tell the frame; add `drive: {{frame: {{kind: local, name: here}}}}` "
        "to the mapping, or `{kind: utm, epsg: 32632}` where east and north are of that zone"
    )


def _place(part: StreamPart, rows: Rows, frame: EarthFrame) -> None:
    if part.name == "reference":
        place_reference(part, rows, frame)
        return
    degrees = "latitude_deg" in rows.columns
    if degrees and not frame.is_utm:
        raise InputError(
            f"gnss: latitudes and longitudes need a UTM frame, and this is {frame}; give `frame: "
            "{kind: utm, epsg: ...}` in `drive`"
        )
    if not degrees and frame.is_utm:
        points = np.stack([rows.numbers("east_m"), rows.numbers("north_m")], axis=1)
        place = geographic_from_grid(frame, points)
        del rows.columns["east_m"], rows.columns["north_m"]
        rows.columns |= {"latitude_deg": place[:, 0], "longitude_deg": place[:, 1]}
    if degrees:
        latitude, longitude = rows.numbers("latitude_deg"), rows.numbers("longitude_deg")
        on_earth = (np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 180.0)
        rows.keep(on_earth, "no latitude and longitude")


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


@contextmanager
def converted_folder(converted: Converted, out: Path, inputs: Sequence[Path]) -> Iterator[Path]:
    """The drive's folder, filled; it appears under its name when the block ends well.

    Raises:
        OutputError: the place cannot be written to.
    """
    with atomic_folder(out, "drive", inputs) as folder:
        text = yaml.safe_dump(_plain(converted.head), sort_keys=False, allow_unicode=True)
        (folder / "drive.yaml").write_text(text, encoding="utf-8")
        for key, rows in converted.streams.items():
            if key == "frames":
                _copy_pictures(converted, folder)
            write_rows(rows, folder / f"{key}.csv")
        yield folder


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    return [_plain(inner) for inner in value] if isinstance(value, list | tuple) else value


def _copy_pictures(converted: Converted, folder: Path) -> None:
    columns = converted.streams["frames"].columns
    for side, name in enumerate(("left", "right")):
        (folder / name).mkdir()
        paths = np.empty(len(converted.pictures), dtype=object)
        for row, pair in enumerate(converted.pictures):
            target = f"{name}/{row:06d}{pair[side].suffix.lower()}"
            shutil.copyfile(pair[side], folder / target)
            paths[row] = target
        columns[name] = paths


def write_rows(rows: Rows, path: Path) -> None:
    """A stream as CSV; what is not known is an empty cell."""
    names = ["stamp_s", *(name for name in rows.columns if name != "stamp_s")]
    form = ",".join(
        "%s" if rows.columns[name].dtype == object else _FORMATS.get(_unit(name), "%.9g")
        for name in names
    )
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(names) + "\n")
        columns = [rows.columns[name] for name in names]
        for first in range(0, len(columns[0]), _ROWS_AT_ONCE):
            block = [column[first : first + _ROWS_AT_ONCE].tolist() for column in columns]
            text = "\n".join([form % row for row in zip(*block, strict=True)])
            file.write(text.replace("nan", "") + "\n")


def _unit(name: str) -> str:
    return "_" + name.rpartition("_")[2]
