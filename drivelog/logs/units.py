"""Units of a logger's columns, and the factor to the unit that our own column's name ends in."""

from __future__ import annotations

import re
from difflib import get_close_matches
from math import pi

_DEG = pi / 180.0
_STANDARD_GRAVITY_MPS2 = 9.80665
# by the ending of our columns: what a logger may write, and its size in our unit
UNITS: dict[str, dict[str, float]] = {
    "_mps2": {
        "m/s2": 1.0, "g": _STANDARD_GRAVITY_MPS2, "mg": 1e-3 * _STANDARD_GRAVITY_MPS2,
        "ft/s2": 0.3048,
    },
    "_radps": {"rad/s": 1.0, "deg/s": _DEG, "mrad/s": 1e-3, "mdeg/s": 1e-3 * _DEG},
    "_mps": {
        "m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704, "kn": 1852.0 / 3600.0, "ft/s": 0.3048,
        "cm/s": 0.01, "mm/s": 0.001,
    },
    "_m2": {"m2": 1.0, "cm2": 1e-4, "mm2": 1e-6, "ft2": 0.3048**2},
    "_m": {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "ft": 0.3048, "in": 0.0254},
    "_rad": {"rad": 1.0, "deg": _DEG, "mrad": 1e-3, "mdeg": 1e-3 * _DEG},
    "_deg": {
        "deg": 1.0, "rad": 1.0 / _DEG, "1e-7 deg": 1e-7, "1e-6 deg": 1e-6, "ddmm.mmmm": 1.0,
    },
    "_nm": {"Nm": 1.0, "kNm": 1000.0},
    "_s": {
        "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "days": 86400.0,
    },
}  # fmt: skip
DEGREES_AND_MINUTES = "ddmm.mmmm"
"""Degrees times 100 plus minutes, as NMEA writes latitudes and longitudes."""

# other spellings, after `_plain`
_SPELLINGS = {
    "m/s": ("mps", "meter/s", "metres/s", "meters/s", "meterspersecond", "m/sec", "ms-1"),
    "km/h": ("kmh", "kph", "kmph", "km/hr", "kmh-1"),
    "mph": ("mi/h", "miles/h"),
    "kn": ("knots", "knot", "kt", "kts"),
    "rad/s": ("radps", "rads", "rad/sec", "rads-1"),
    "deg/s": ("degps", "dps", "degs", "deg/sec", "degrees/s"),
    "rad": ("radians", "radian"),
    "deg": ("degrees", "degree", "grad"),
    "m": ("metre", "metres", "meter", "meters"),
    "ft": ("feet", "foot"),
    "m/s2": ("mps2", "m/s/s", "m/sec2", "ms-2"),
    "s": ("sec", "secs", "second", "seconds"),
    "ms": ("msec", "millis", "milliseconds", "millisecond"),
    "us": ("usec", "micros", "microseconds"),
    "ns": ("nsec", "nanos", "nanoseconds", "nanosec"),
    "min": ("minutes",),
    "h": ("hours",),
    "days": ("d", "day"),
    "1e-7 deg": ("1e-7deg", "deg*1e-7", "deg1e-7", "degx1e7", "dege7", "e7"),
    "1e-6 deg": ("1e-6deg", "deg*1e-6", "deg1e-6", "dege6"),
    "Nm": ("nm", "newtonmetre", "n*m"),
    "g": ("g0", "gs", "gee"),
}


def _plain(text: str) -> str:
    text = text.strip().replace("°", "deg").replace("µ", "u").replace("μ", "u")
    text = text.replace("²", "2").replace("^", "").replace("·", "*").replace("⁻", "-")
    text = text.replace("¹", "1").replace(" ", "")
    return text.replace("/sec", "/s") if text.endswith("/sec") else text


_NAMES: dict[str, str] = {}
for _table in UNITS.values():
    _NAMES.update({_plain(unit): unit for unit in _table})
for _unit, _spelled in _SPELLINGS.items():
    _NAMES.update({name: _unit for name in _spelled if name not in _NAMES})


def unit_named(text: str) -> str | None:
    """The unit that a text spells, such as `km/h` for `[kph]`; None for any other text."""
    plain = _plain(text.strip().strip("[](){}<>"))
    return _NAMES.get(plain) or _NAMES.get(plain.lower())


def ending_of(column: str) -> str | None:
    """The ending of one of our columns that stands for its unit; None for a pure number."""
    return next((ending for ending in UNITS if column.endswith(ending)), None)


def units_for(column: str) -> list[str]:
    """Units in which a logger may give one of our columns."""
    ending = ending_of(column)
    return list(UNITS[ending]) if ending else []


def factor(column: str, unit: str) -> float | None:
    """Size of a logger's unit in that of our column; None where it is no such unit."""
    ending, known = ending_of(column), unit_named(unit)
    if ending is None or known is None:
        return None
    return UNITS[ending].get(known)


def nearest_unit(column: str, unit: str) -> str | None:
    """The unit that was probably meant."""
    near = get_close_matches(unit.lower(), [u.lower() for u in units_for(column)], n=1)
    return next((u for u in units_for(column) if near and u.lower() == near[0]), None)


_BRACKETS = re.compile(r"[\[({<]([^\])}>]+)[\])}>]\s*$")


def unit_in_header(name: str, column: str) -> str | None:
    """The unit that a header states for what is to be one of our columns; None if it does not.

    `v [km/h]`, `v (km/h)`, `v_kmh`, `v_km_h` and `v/kmh` state one.
    """
    ending = ending_of(column)
    if ending is None:
        return None
    allowed = UNITS[ending]
    found = _BRACKETS.search(name)
    if found:
        unit = unit_named(found.group(1))
        return unit if unit in allowed else None
    words = re.split(r"[_\s]", name.strip())
    for count in (3, 2, 1):
        if len(words) > count:
            for joint in ("", "/"):
                unit = unit_named(joint.join(words[-count:]))
                # `v_ms` is metres a second, `t_ms` milliseconds
                if unit == "ms" and ending == "_mps":
                    unit = "m/s"
                if unit in allowed:
                    return unit
    return None
