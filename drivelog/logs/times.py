"""Stamps as loggers write them: numbers in a unit, ISO 8601, other texts, GPS week and seconds.

All become seconds since 1970-01-01 UTC, but for numbers that count from elsewhere, which stay as
they count. GPS time runs ahead of UTC by the leap seconds that the mapping states.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from datetime import UTC, date, datetime, timedelta, timezone, tzinfo
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.logs.column_parts import Stamps
from polemap.drivelog.logs.units import factor, units_for

Floats = NDArray[np.float64]
Texts = Callable[[Sequence[str], Sequence[int]], Floats]

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
# IS-GPS-200: the epoch of GPS time
GPS_EPOCH_S = (datetime(1980, 1, 6, tzinfo=UTC) - _EPOCH).total_seconds()
_WEEK_S = 604_800.0
# a week of ten bits begins anew every 1024 weeks; 2000 began in week 1042
_FULL_WEEK_LEAST = 1024
# leap seconds of UTC since GPS time began, by the day from which they count (IERS Bulletin C)
_LEAPS = (
    (date(1999, 1, 1), 13), (date(2006, 1, 1), 14), (date(2009, 1, 1), 15), (date(2012, 7, 1), 16),
    (date(2015, 7, 1), 17), (date(2017, 1, 1), 18),
)  # fmt: skip
_OFFSET = re.compile(r"([+-])(\d{2}):?(\d{2})")
_DAY_S = 86400.0
_ISO_LIKE = re.compile(r"\d{4}-?\d{2}-?\d{2}([T ].*)?")
_SLASHED = re.compile(r"(\d{1,2})[/.](\d{1,2})[/.](\d{2,4})(.*)")
_OF_DAY = re.compile(r"\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?")


def leap_seconds_on(stamp_s: float) -> int | None:
    """Seconds by which GPS time was ahead of UTC; None before 1999."""
    day = (_EPOCH + timedelta(seconds=stamp_s)).date()
    return next((leap for since, leap in reversed(_LEAPS) if day >= since), None)


def parse_zone(text: str) -> tzinfo:
    """UTC, an offset such as `+02:00`, or a name such as `Europe/Berlin`.

    Raises:
        InputError: no such zone.
    """
    if text.upper() in ("UTC", "Z", "GMT"):
        return UTC
    found = _OFFSET.fullmatch(text)
    if found:
        minutes = int(found[2]) * 60 + int(found[3])
        return timezone((1 if found[1] == "+" else -1) * timedelta(minutes=minutes))
    try:
        return ZoneInfo(text)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise InputError(
            f"zone '{text[:40]}' is unknown; give UTC, an offset such as '+02:00', or a name such "
            "as Europe/Berlin"
        ) from None


def parse_date(text: str) -> date:
    """A day as `2024-05-31`.

    Raises:
        InputError: no such day.
    """
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise InputError(f"date '{text[:40]}' is no day such as 2024-05-31") from None


def gps_stamps(seconds: Floats, weeks: Floats | None, leap_seconds: int) -> Floats:
    """Seconds since 1970 UTC `(n,)` of GPS seconds, since the epoch or since the start of `weeks`.

    Raises:
        InputError: weeks of ten bits, or seconds beyond a week.
    """
    if weeks is None:
        return np.asarray(seconds + GPS_EPOCH_S - leap_seconds)
    known = weeks[np.isfinite(weeks)]
    if len(known) and known.min() < _FULL_WEEK_LEAST:
        raise InputError(
            f"GPS week {known.min():.0f} counts from 1999 or 2019 again, not from 1980; give the "
            "full week (add 2048 to it for logs after April 2019)"
        )
    if np.any(seconds[np.isfinite(seconds)] > _WEEK_S):
        raise InputError(
            f"{np.nanmax(seconds):.0f} seconds of week, a week has {_WEEK_S:.0f}; mind the unit, "
            "or give `epoch: gps` without `week`"
        )
    return np.asarray(weeks * _WEEK_S + seconds + GPS_EPOCH_S - leap_seconds)


def number_unit(stamps: Stamps, header_unit: str | None, cells: Floats) -> float:
    """Seconds in the unit of a column of numbers.

    Raises:
        InputError: neither mapping nor header say the unit.
    """
    unit = stamps.unit or header_unit
    if unit is None:
        middle = float(np.median(np.abs(cells))) if len(cells) else 0.0
        likely = next(
            (
                u
                for most, u in ((1e8, None), (1e11, "s"), (1e14, "ms"), (1e17, "us"), (1e20, "ns"))
                if middle < most
            ),
            None,
        )
        hint = f" ({middle:.4g} looks like {likely} since 1970)" if likely else ""
        raise InputError(
            f"the unit of the stamps is not said{hint}; add `unit: {likely or 's'}` or another of "
            f"{', '.join(units_for('stamp_s'))}"
        )
    size = factor("stamp_s", unit)
    if size is None:
        raise InputError(f"'{unit}' is no unit of time; known: {', '.join(units_for('stamp_s'))}")
    return size


def text_reader(stamps: Stamps, samples: Sequence[str], missing: frozenset[str]) -> Texts:
    """What reads texts of date and time, after a look at the first ones.

    Raises:
        InputError: the order of day and month, the zone or the day itself is not said.
    """
    zone = parse_zone(stamps.zone) if stamps.zone is not None else None
    day = parse_date(stamps.date) if stamps.date is not None else None
    if stamps.unit is not None:
        raise InputError(f"'{samples[0][:30]}' is a text and has no unit; delete `unit`")
    if stamps.format not in (None, "iso"):
        return _formatted(str(stamps.format), zone, day, missing)
    if all(_ISO_LIKE.fullmatch(text) for text in samples):
        return _iso(zone, missing)
    shown = samples[0][:30]
    if all(_OF_DAY.fullmatch(text) for text in samples):
        if day is None:
            raise InputError(
                f"'{shown}' has no day; add `date: 2024-05-31` (of the first row) and `zone`"
            )
        longest = max(samples, key=len)
        seconds = ":%S" if longest.count(":") == 2 else ""
        point = ".%f" if "." in longest else ""
        return _formatted(f"%H:%M{seconds}{point}", zone, day, missing)
    found = _SLASHED.fullmatch(samples[0])
    if found:
        mark = samples[0][len(found[1])]
        year = "%Y" if len(found[3]) == 4 else "%y"
        rest = found[4].strip()
        clock = (" %H:%M" + ":%S" * (rest.count(":") == 2) + ".%f" * ("." in rest)) if rest else ""
        forms = [
            f"'{mark.join(order)}{clock}'" for order in (("%d", "%m", year), ("%m", "%d", year))
        ]
        raise InputError(
            f"is '{shown}' day or month first? add `format: {forms[0]}` or `format: {forms[1]}`"
        )
    raise InputError(
        f"'{shown}' is no time of ISO 8601; add its format, such as `format: '%d %b %Y %H:%M:%S'`"
    )


def _require_zone(zone: tzinfo | None, text: str, line: int) -> tzinfo:
    if zone is None:
        raise InputError(
            f"line {line}: the zone of '{text[:40]}' is not said; add `zone: UTC`, an offset such "
            "as `zone: '+02:00'`, or `zone: Europe/Berlin`"
        )
    return zone


def _iso(zone: tzinfo | None, missing: frozenset[str]) -> Texts:
    offsets: set[timedelta | None] = set()

    def read(cells: Sequence[str], lines: Sequence[int]) -> Floats:
        values = np.full(len(cells), np.nan)
        for row, cell in enumerate(cells):
            text = cell.strip()
            if text.lower() in missing:
                continue
            try:
                moment = datetime.fromisoformat(text)
            except ValueError:
                raise InputError(
                    f"line {lines[row]}: '{text[:40]}' is no time of ISO 8601"
                ) from None
            if moment.tzinfo is None:
                moment = moment.replace(tzinfo=_require_zone(zone, text, lines[row]))
                offsets.add(moment.utcoffset())
                _check_one_offset(offsets, text, lines[row])
            values[row] = (moment - _EPOCH).total_seconds()
        return values

    return read


def _check_one_offset(offsets: set[timedelta | None], text: str, line: int) -> None:
    if len(offsets) > 1:
        raise InputError(
            f"line {line}: the clocks are changed before '{text[:40]}', and an hour may stand "
            "twice or not at all; give a fixed offset such as `zone: '+02:00'`"
        )


def _formatted(form: str, zone: tzinfo | None, day: date | None, missing: frozenset[str]) -> Texts:
    """Texts of a `strptime` format; without a date in it, the day of the first row counts on."""
    import pandas as pd  # slow to import, and most logs count seconds

    dated = any(mark in form for mark in ("%d", "%j", "%x", "%c"))
    if not dated and day is None:
        raise InputError(f"format '{form}' has no day; add `date: 2024-05-31` (of the first row)")
    zoned = "%z" in form
    offsets: set[timedelta | None] = set()
    state = {"days": 0.0, "last": -np.inf}

    def read(cells: Sequence[str], lines: Sequence[int]) -> Floats:
        texts = pd.Series([cell.strip() for cell in cells], dtype=object)
        texts[texts.str.lower().isin(missing)] = None
        if not zoned and texts.notna().any():
            first = str(texts.dropna().iloc[0])
            _require_zone(zone, first, lines[0])
        moments = pd.to_datetime(texts, format=form, errors="coerce", utc=zoned)
        if ".%f" in form:  # loggers leave .000 out
            whole = form.replace(".%f", "")
            late = pd.to_datetime(texts, format=whole, errors="coerce", utc=zoned)
            moments = moments.fillna(late)
        wrong = np.flatnonzero((moments.isna() & texts.notna()).to_numpy())
        if len(wrong):
            row = int(wrong[0])
            raise InputError(
                f"line {lines[row]}: '{str(texts.iloc[row])[:40]}' is no time of the format "
                f"'{form}'"
            )
        given = moments.notna().to_numpy()
        values = np.full(len(cells), np.nan)
        naive = moments.dt.tz_localize(None) if zoned else moments
        values[given] = naive[given].astype("datetime64[ns]").astype(np.int64).to_numpy() / 1e9
        if not dated:
            values = _counted_days(values % _DAY_S, state)
            assert day is not None  # refused above
            values += (datetime(day.year, day.month, day.day, tzinfo=UTC) - _EPOCH).total_seconds()
        if zoned or zone is None:
            return values
        # offsets change twice a year at most: the ends of a block tell
        for row in np.flatnonzero(given)[[0, -1]] if given.any() else ():
            local = _EPOCH.replace(tzinfo=None) + timedelta(seconds=float(values[row]))
            offsets.add(local.replace(tzinfo=zone).utcoffset())
            _check_one_offset(offsets, str(texts.iloc[row]), lines[row])
        shift = next(iter(offsets), None) or timedelta()
        return np.asarray(values - shift.total_seconds())

    return read


def _counted_days(of_day: Floats, state: dict[str, float]) -> Floats:
    """Times of day `(n,)` counted on over midnight: a fall by more than half a day is a new one."""
    known = np.flatnonzero(np.isfinite(of_day))
    values = np.full(len(of_day), np.nan)
    if len(known):
        given = of_day[known]
        before = np.concatenate([[state["last"]], given[:-1]])
        days = state["days"] + np.cumsum(given < before - _DAY_S / 2.0)
        values[known] = given + days * _DAY_S
        state["last"], state["days"] = float(given[-1]), float(days[-1])
    return values
