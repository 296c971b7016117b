"""Samples as JSON, one object a line: the plainest way for a program to feed the localizer.

```
{"type": "odometry", "stamp_s": 12.34, "speed_mps": 8.1, "yaw_rate_radps": 0.02}
{"type": "gnss", "stamp_s": 12.3, "latitude_deg": 49.01, "longitude_deg": 8.42, "hdop": 1.1}
{"type": "gnss", "stamp_s": 12.3, "east_m": 3.1, "north_m": -7.2, "hdop": 1.1}
{"type": "poles", "stamp_s": 12.3, "poles": [{"x_m": 9.1, "y_m": 3.2, "var_x_m2": 0.01,
    "var_y_m2": 0.01, "cov_xy_m2": 0.0, "width_m": 0.2, "probability": 0.9}]}
{"type": "frame", "stamp_s": 12.3, "left": "left/000123.png", "right": "right/000123.png"}
```

Every line may carry `arrival_s`; without it a sample arrives when it is read. Poles are in the
vehicle frame, `width_m` and `probability` may be left out. Image paths count from the working
folder.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from polemap.drivelog.detections import Detections, VisibleRegion, pole_detections
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame, grid_from_geographic
from polemap.drivelog.images import read_grey
from polemap.drivelog.live.growing import GrowingBytes
from polemap.drivelog.live.pending import PendingFrame
from polemap.drivelog.samples import GnssFix, OdometrySample

# three hundred poles, with every number written out
LONGEST_LINE = 1 << 18
MOST_POLES = 300
TYPES = ("odometry", "gnss", "poles", "frame")


@dataclass(frozen=True, slots=True)
class BadLine:
    """A line that is no sample, and why."""

    reason: str


def read_lines(
    source: GrowingBytes, frame: EarthFrame, view: VisibleRegion | None
) -> Iterator[OdometrySample | GnssFix | Detections | PendingFrame | BadLine]:
    """Samples in the order of the lines; `arrival_s` NaN where a line does not say it.

    Args:
        frame: of the drive, for positions of either kind.
        view: what the detector of the poles can see.
    """
    number = 0
    while True:
        line = source.readline(LONGEST_LINE)
        if not line:
            return
        number += 1
        if not line.strip():
            continue
        try:
            yield _sample(_object(line), frame, view, number)
        except InputError as error:
            yield BadLine(f"line {number}: {error}")


def _object(line: bytes) -> Mapping[str, Any]:
    if not line.endswith(b"\n") and len(line) >= LONGEST_LINE:
        raise InputError(f"is longer than {LONGEST_LINE} bytes")
    try:
        value = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise InputError(f"is no JSON ({error})") from error
    if not isinstance(value, dict):
        raise InputError(f"is a {type(value).__name__}, an object was expected")
    return value


def _sample(
    line: Mapping[str, Any], frame: EarthFrame, view: VisibleRegion | None, number: int
) -> OdometrySample | GnssFix | Detections | PendingFrame:
    kind, stamp = line.get("type"), _number(line, "stamp_s")
    arrival = _number(line, "arrival_s") if "arrival_s" in line else float("nan")
    if kind == "odometry":
        speed, turn = _number(line, "speed_mps"), _number(line, "yaw_rate_radps")
        return OdometrySample(stamp, arrival, speed, turn)
    if kind == "gnss":
        east, north = _place(line, frame)
        hdop = _number(line, "hdop") if "hdop" in line else 1.0
        if not hdop > 0.0:
            raise InputError(f"hdop is {hdop:g}, it must be positive")
        return GnssFix(stamp, arrival, east, north, hdop)
    if kind == "poles":
        return _poles(line, stamp, arrival, view)
    if kind == "frame":
        left, right = (_path(line, name) for name in ("left", "right"))
        return PendingFrame(stamp, arrival, number, lambda: (read_grey(left), read_grey(right)))
    raise InputError(f"type is {str(kind)[:40]!r}; known are {', '.join(TYPES)}")


def _place(line: Mapping[str, Any], frame: EarthFrame) -> tuple[float, float]:
    if "latitude_deg" not in line:
        return _number(line, "east_m"), _number(line, "north_m")
    latitude, longitude = _number(line, "latitude_deg"), _number(line, "longitude_deg")
    if abs(latitude) > 90.0 or abs(longitude) > 180.0:
        raise InputError(f"latitude {latitude:g}, longitude {longitude:g} are nowhere on the earth")
    if not frame.is_utm:
        raise InputError(f"latitude and longitude cannot be put into {frame}; send east_m, north_m")
    east, north = grid_from_geographic(frame, [latitude], [longitude])[0]
    return float(east), float(north)


def _poles(
    line: Mapping[str, Any], stamp: float, arrival: float, view: VisibleRegion | None
) -> Detections:
    poles = line.get("poles")
    if not isinstance(poles, list) or not all(isinstance(pole, dict) for pole in poles):
        raise InputError("poles is no list of objects")
    if len(poles) > MOST_POLES:
        raise InputError(f"{len(poles)} poles in one scan; {MOST_POLES} can be taken")
    names = ("x_m", "y_m", "var_x_m2", "var_y_m2", "cov_xy_m2")
    rows = np.array([[_number(pole, name) for name in names] for pole in poles]).reshape(-1, 5)
    covariance = rows[:, [2, 4, 4, 3]].reshape(-1, 2, 2)
    if np.any(rows[:, 2] <= 0) or np.any(np.linalg.det(covariance) <= 0):
        raise InputError("a covariance is not positive definite")
    optional = {
        name: [_number(pole, name) if name in pole else default for pole in poles]
        for name, default in (("width_m", float("nan")), ("probability", 1.0))
    }
    return pole_detections(stamp, arrival, rows[:, :2], covariance, view=view, **optional)


def _number(values: Mapping[str, Any], name: str) -> float:
    value = values.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        said = "is missing" if value is None else f"is {str(value)[:40]!r}, no number"
        raise InputError(f"{name} {said}")
    try:
        number = float(value)
    except OverflowError as error:
        raise InputError(f"{name} is beyond all numbers") from error
    if not isfinite(number):
        raise InputError(f"{name} is {number}")
    return number


def _path(values: Mapping[str, Any], name: str) -> Path:
    value = values.get(name)
    if not isinstance(value, str) or not value or "\0" in value:
        raise InputError(f"{name} is {str(value)[:40]!r}, no path of an image")
    return Path(value)
