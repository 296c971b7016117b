"""GPX tracks: points with time, and their dilution where it is said.

Source: GPX 1.1 schema (topografix.com); times are UTC unless they say otherwise.
"""

from __future__ import annotations

from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from xml.parsers import expat

import numpy as np

from polemap.drivelog.errors import InputError
from polemap.drivelog.logs.log_files import PointLog
from polemap.parsing.errors import ParsingError, named
from polemap.parsing.text import MEGABYTE, check_size

LARGEST_BYTES = 1000 * MEGABYTE
_BLOCK = 1 << 20
_LONGEST_TEXT = 200
_NUMBERS = {"hdop": "hdop", "speed": "speed_mps", "course": "course_deg"}


def read_gpx(path: Path) -> PointLog:
    """Track points that have a time.

    Raises:
        InputError: no GPX, or a track whose points have no times.
    """
    reader = _Reader()
    parser = expat.ParserCreate(namespace_separator=" ")
    parser.buffer_text = True
    parser.StartElementHandler = reader.start
    parser.EndElementHandler = reader.end
    parser.CharacterDataHandler = reader.text
    parser.StartDoctypeDeclHandler = reader.refuse
    parser.EntityDeclHandler = reader.refuse
    with named(path, InputError, "GPX track"):
        check_size(path, LARGEST_BYTES)
        with path.open("rb") as file:
            try:
                while block := file.read(_BLOCK):
                    reader.line = parser.CurrentLineNumber
                    parser.Parse(block)
                parser.Parse(b"", True)
            except expat.ExpatError as error:
                raise InputError(f"{path}: no GPX ({error}); restore the file") from error
    return reader.finish(path)


class _Reader:
    def __init__(self) -> None:
        self.dropped: Counter[str] = Counter()
        self.points: list[dict[str, float]] = []
        self.point: dict[str, float] | None = None
        self.content: list[str] = []
        self.read = 0
        self.other = 0
        self.line = 1
        self.is_gpx = False

    def refuse(self, *_rest: object) -> None:
        """Entities can stand for anything, of any length.

        Raises:
            ParsingError: always.
        """
        raise ParsingError("GPX with a document type or entities is not read; remove them")

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        name = tag.rpartition(" ")[2]
        self.content = []
        if name == "gpx":
            self.is_gpx = True
        elif name in ("rtept", "wpt"):
            self.other += 1
        elif name == "trkpt":
            self.read += 1
            try:
                place = float(attributes["lat"]), float(attributes["lon"])
            except (KeyError, ValueError):
                self.dropped["points without a place"] += 1
                return
            if not (abs(place[0]) <= 90.0 and abs(place[1]) <= 180.0):
                self.dropped["points off the earth"] += 1
                return
            self.point = {"latitude_deg": place[0], "longitude_deg": place[1]}

    def text(self, data: str) -> None:
        if self.point is not None and sum(map(len, self.content)) < _LONGEST_TEXT:
            self.content.append(data)

    def end(self, tag: str) -> None:
        name = tag.rpartition(" ")[2]
        text, self.content = "".join(self.content).strip(), []
        if self.point is None:
            return
        if name == "trkpt":
            if "stamp_s" in self.point:
                self.points.append(self.point)
            else:
                self.dropped["points without a time"] += 1
            self.point = None
        elif name == "time":
            try:
                moment = datetime.fromisoformat(text)
            except ValueError:
                return
            moment = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
            self.point["stamp_s"] = moment.timestamp()
        elif name in _NUMBERS:
            try:
                self.point[_NUMBERS[name]] = float(text)
            except ValueError:
                self.dropped[f"{name} that is no number (the point stays)"] += 1

    def finish(self, path: Path) -> PointLog:
        """The points as columns.

        Raises:
            InputError: none that can be used.
        """
        if not self.is_gpx:
            raise InputError(f"{path}: no GPX; its root is called otherwise")
        if not self.points:
            why = ", ".join(f"{count} {kind}" for kind, count in self.dropped.items())
            what = f"none of {self.read} track points can be used ({why})"
            what = what if self.read else "no track points"
            routes = f" and {self.other} points of routes" if self.other else ""
            raise InputError(
                f"{path}: {what}{routes}; export the track as it was recorded, with times"
            )
        columns = {}
        for name in ("stamp_s", "latitude_deg", "longitude_deg", *_NUMBERS.values()):
            values = np.array([point.get(name, np.nan) for point in self.points])
            if np.isfinite(values).any():
                columns[name] = values
        says = "GPX" + (f", {self.other} points of routes left aside" if self.other else "")
        lines = np.arange(len(self.points), dtype=np.int64) + 1
        return PointLog(path, says, columns, lines, self.read, self.dropped)
