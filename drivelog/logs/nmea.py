"""NMEA 0183 logs: GGA and RMC for fixes, GSA for their dilution, VTG for course and speed.

Source: NMEA 0183, sentences GGA, RMC, VTG, GSA and ZDA; checksum: the exclusive or of all
characters between `$` and `*`. Text before a `$` (a logger's own stamp) is left aside.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, timedelta
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np

from polemap.drivelog.errors import InputError
from polemap.drivelog.logs.log_files import PointLog
from polemap.drivelog.logs.text import encoding_of, lines_of, open_text
from polemap.drivelog.logs.times import parse_date

ENDINGS = (".nmea", ".nma", ".ubx.txt")
_SENTENCE = re.compile(r"\$([A-Z]{2})([A-Z]{3}),([^*\r\n]*)(?:\*([0-9A-Fa-f]{2}))?\s*$")
_KNOWN = ("GGA", "RMC", "VTG", "GSA", "ZDA")
_KNOT_MPS = 1852.0 / 3600.0
_DAY_S = 86400.0
_COLUMNS = (
    "latitude_deg",
    "longitude_deg",
    "hdop",
    "satellites",
    "fix_quality",
    "speed_mps",
    "course_deg",
)


@dataclass(slots=True)
class _Epoch:
    """What the sentences of one moment say."""

    of_day_s: float
    line: int
    talker: str
    values: dict[str, float] = field(default_factory=dict)
    fixed: bool = True


def looks_like_nmea(lines: list[str]) -> bool:
    """Whether most of a log's lines are sentences, whatever the file is called."""
    texts = [line for line in lines if line.strip()]
    found = sum(_sentence(line) is not None for line in texts)
    return bool(texts) and 2 * found > len(texts)


def _sentence(line: str) -> re.Match[str] | None:
    at = line.find("$")
    return _SENTENCE.match(line[at:]) if at >= 0 else None


def read_nmea(path: Path, day: str | None = None) -> PointLog:
    """Fixes of a log, one an epoch.

    Args:
        path: the log.
        day: of the first sentence, where no RMC or ZDA says it.

    Raises:
        InputError: no sentence that can be used, or no date.
    """
    reader = _Reader(parse_date(day) if day is not None else None)
    with open_text(path, _encoding(path)) as file:
        for number, line in enumerate(lines_of(file), start=1):
            reader.take(number, line)
    return reader.finish(path)


def _encoding(path: Path) -> str:
    # a damaged byte makes a damaged sentence, which its checksum tells
    found = encoding_of(path)
    return "latin-1" if found == "utf-8" else found


class _Reader:
    def __init__(self, day: date | None) -> None:
        self.dropped: Counter[str] = Counter()
        self.notes: Counter[str] = Counter()
        self.talkers: Counter[str] = Counter()
        self.epochs: list[_Epoch] = []
        self.days: list[tuple[int, date]] = []  # epoch at which a date was said
        self.stated = day
        self.hdop = float("nan")
        self.read = 0
        self.checked = False

    def take(self, number: int, line: str) -> None:
        """One line of the log."""
        if not line.strip():
            return
        self.read += 1
        found = _sentence(line)
        if found is None:
            self.dropped["damaged sentences" if "$" in line else "lines without a sentence"] += 1
            return
        talker, kind, content, checksum = found.groups()
        # a receiver writes all its sentences with a checksum or none; one that lacks it is cut off
        self.checked |= checksum is not None
        if checksum is None and self.checked:
            self.dropped["damaged sentences"] += 1
            return
        if checksum is None:
            self.notes["sentences without a checksum were taken"] += 1
        elif reduce(xor, f"{talker}{kind},{content}".encode("latin-1", "replace")) != int(
            checksum, 16
        ):
            self.dropped["damaged sentences"] += 1
            return
        if kind not in _KNOWN:
            self.dropped["other sentences"] += 1
            return
        try:
            getattr(self, f"_{kind.lower()}")(number, talker, content.split(","))
        except (ValueError, IndexError):
            self.dropped["damaged sentences"] += 1

    def _epoch(self, number: int, talker: str, text: str) -> _Epoch:
        of_day = int(text[:2]) * 3600.0 + int(text[2:4]) * 60.0 + float(text[4:])
        if not 0.0 <= of_day < _DAY_S + 1.0:
            raise ValueError(text)
        for epoch in reversed(self.epochs[-4:]):
            if epoch.of_day_s == of_day and epoch.talker == talker:
                return epoch
        self.epochs.append(_Epoch(of_day, number, talker))
        return self.epochs[-1]

    def _gga(self, number: int, talker: str, cells: list[str]) -> None:
        quality = int(cells[5] or 0)
        epoch = self._epoch(number, talker, cells[0])
        self.talkers[talker] += 1
        if quality == 0 or not cells[1]:
            epoch.fixed = False
            return
        epoch.values |= {
            "latitude_deg": _angle(cells[1], cells[2], "S", 90.0),
            "longitude_deg": _angle(cells[3], cells[4], "W", 180.0),
            "fix_quality": float(quality),
            "hdop": float(cells[7]) if cells[7] else self.hdop,
            "satellites": float(cells[6]) if cells[6] else float("nan"),
        }

    def _rmc(self, number: int, talker: str, cells: list[str]) -> None:
        epoch = self._epoch(number, talker, cells[0])
        if cells[8]:
            day, month, year = int(cells[8][:2]), int(cells[8][2:4]), int(cells[8][4:6])
            said = date(2000 + year if year < 80 else 1900 + year, month, day)
            self.days.append((len(self.epochs) - 1, said))
        self.talkers[talker] += 1
        if cells[1].upper() != "A":
            epoch.fixed = False
            return
        epoch.values.setdefault("latitude_deg", _angle(cells[2], cells[3], "S", 90.0))
        epoch.values.setdefault("longitude_deg", _angle(cells[4], cells[5], "W", 180.0))
        epoch.values.setdefault("hdop", self.hdop)
        if cells[6]:
            epoch.values["speed_mps"] = float(cells[6]) * _KNOT_MPS
        if cells[7]:
            epoch.values["course_deg"] = float(cells[7])

    def _vtg(self, _number: int, talker: str, cells: list[str]) -> None:
        epoch = next((e for e in reversed(self.epochs[-4:]) if e.talker == talker), None)
        if epoch is None:
            return
        if cells[0]:
            epoch.values.setdefault("course_deg", float(cells[0]))
        if cells[6]:
            epoch.values.setdefault("speed_mps", float(cells[6]) / 3.6)

    def _gsa(self, _number: int, _talker: str, cells: list[str]) -> None:
        self.hdop = float(cells[15]) if cells[15] else self.hdop

    def _zda(self, number: int, talker: str, cells: list[str]) -> None:
        said = date(int(cells[3]), int(cells[2]), int(cells[1]))
        self._epoch(number, talker, cells[0])
        self.days.append((len(self.epochs) - 1, said))

    def finish(self, path: Path) -> PointLog:
        """Epochs of one talker that have a position, dated."""
        if not self.talkers:
            raise InputError(
                f"{path}: no GGA or RMC sentence that can be used "
                f"({_counts(self.dropped) or 'empty'}); give a log of an NMEA receiver"
            )
        stamps = self._stamps(path)
        # fixes of several systems from one receiver are one journey: the most complete is taken
        talker = max(self.talkers, key=lambda name: (self.talkers[name], name == "GN"))
        rows = []
        for row, epoch in enumerate(self.epochs):
            if epoch.talker != talker:
                self.dropped["fixes of another talker"] += "latitude_deg" in epoch.values
            elif not epoch.fixed or "latitude_deg" not in epoch.values:
                self.dropped["epochs without a fix"] += 1
            else:
                rows.append(row)
        columns = {"stamp_s": stamps[rows]}
        for name in _COLUMNS:
            values = [self.epochs[row].values.get(name, np.nan) for row in rows]
            if np.isfinite(values).any():
                columns[name] = np.array(values, dtype=np.float64)
        says = [f"NMEA 0183, talker {talker}"]
        says += [f"{count} {what}" for what, count in self.notes.items()]
        lines = np.array([self.epochs[row].line for row in rows], dtype=np.int64)
        self.dropped += Counter()  # without what was counted 0 times
        return PointLog(path, ", ".join(says), columns, lines, self.read, self.dropped)

    def _stamps(self, path: Path) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Seconds since 1970 of all epochs: days are counted on at midnight."""
        of_day = np.array([epoch.of_day_s for epoch in self.epochs])
        days = np.cumsum(np.diff(of_day, prepend=of_day[:1]) < -_DAY_S / 2.0)
        if self.days:
            row, said = self.days[0]
            first = said - timedelta(days=int(days[row]))
            wrong = sum(first + timedelta(days=int(days[r])) != d for r, d in self.days)
            if wrong:
                self.notes["dates that contradict the count of midnights were not taken"] = wrong
        elif self.stated is not None:
            first = self.stated
        else:
            raise InputError(
                f"{path}: GGA sentences have no date, and no RMC or ZDA says it; add `date: "
                "2024-05-31` to the section gnss of the mapping, or --date 2024-05-31"
            )
        epoch = datetime(first.year, first.month, first.day, tzinfo=UTC).timestamp()
        return np.asarray(epoch + days * _DAY_S + of_day)


def _counts(dropped: Counter[str]) -> str:
    return ", ".join(f"{count} {what}" for what, count in dropped.items())


def _angle(text: str, side: str, negative: str, most: float) -> float:
    """Degrees of `ddmm.mmmm` and a side.

    Raises:
        ValueError: no angle within `most`, or no side.
    """
    point = text.index(".") if "." in text else len(text)
    degrees = int(text[: point - 2]) + float(text[point - 2 :]) / 60.0
    if side not in ("N", "S", "E", "W") or degrees > most:
        raise ValueError(text)
    return -degrees if side == negative else degrees
