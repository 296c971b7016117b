"""How noisy each GPS fix is: by speed, dilution or satellites, and where its course is from.

A receiver's speed is a Doppler measurement: its error is about alike in both directions and grows
with the horizontal dilution of precision (HDOP), and the course errs by the speed's error over the
speed. The configured deviations are those of a fix with an HDOP of 1 or less.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.signals import SignalLog

Floats = NDArray[np.float64]

# HDOP by satellites in use: the median over skies on which they stand at random, 10 degrees above
# the horizon at least (the inverse of the geometry matrix; Langley, Dilution of Precision, GPS
# World 10(5), 1999, has the formula)
_SATELLITES = (4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0)
_HDOP = (4.1, 2.3, 1.65, 1.4, 1.2, 1.1, 1.0, 0.87)
# what a position differs by from the one before beside the motion, at an HDOP of 1
POSITION_STEP_SD_M = 0.03
# a fix below this has no course that could be used; its deviation is that of this speed
_LEAST_MPS = 0.5


def dilution(log: SignalLog) -> Floats:
    """HDOP of each row `(n,)`, 1 at least: as given, else by satellites; 1 where neither is."""
    n = len(log)
    hdop = log.columns.get("hdop", np.full(n, np.nan))
    satellites = log.columns.get("satellites", np.full(n, np.nan))
    by_count = np.interp(satellites, _SATELLITES, _HDOP)
    known = np.where(np.isfinite(hdop), hdop, by_count)
    return np.asarray(np.maximum(np.where(np.isfinite(known), known, 1.0), 1.0))


def with_fix_noise(log: SignalLog, config: EstimatorConfig) -> SignalLog:
    """A log whose fixes state `course_sd_rad` and `speed_sd_mps` where it knows what these hang on.

    Columns `hdop`, `satellites` (in use) and `course_baseline_m` (distance of the two positions
    that a course was made of) are looked at; a log without them, or that states deviations
    itself, stays as it is.
    """
    if log.has("course_sd_rad") or log.has("speed_sd_mps") or not log.has("speed_mps"):
        return log
    if not any(log.has(name) for name in ("hdop", "satellites", "course_baseline_m")):
        return log
    n, speed = len(log), log.columns["speed_mps"]
    factor = dilution(log)
    fast = np.maximum(np.abs(speed), _LEAST_MPS)
    speed_sd = config.speed_sd_mps * factor
    course_sd = np.maximum(config.course_sd_rad * factor, speed_sd / fast)
    way = log.columns.get("course_baseline_m", np.full(n, np.nan))
    made = np.isfinite(way) & (way > 0.0)
    turned = np.sqrt(2.0) * POSITION_STEP_SD_M * factor / np.where(made, way, 1.0)
    course_sd = np.where(made, np.maximum(turned, config.course_sd_rad), course_sd)
    speed_sd = np.where(made, np.maximum(turned * fast, config.speed_sd_mps), speed_sd)
    fixes = np.isfinite(speed)
    stated = {
        "course_sd_rad": np.where(fixes, course_sd, np.nan),
        "speed_sd_mps": np.where(fixes, speed_sd, np.nan),
    }
    return SignalLog(log.stamp_s, {**log.columns, **stated})
