"""Fixes of a receiver's own log: clocks brought together, courses from positions, poor ones out."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.electric.receiver import join_receiver
from polemap.electric.signals import SignalLog


def drive(seconds: float = 60.0) -> tuple[SignalLog, dict[str, np.ndarray]]:
    """A car in a wide bend with changing speed, and its fixes, 5 a second in UTC."""
    t = np.arange(0.0, seconds, 0.01)
    speed = 12.0 + 5.0 * np.sin(0.3 * t) + 2.0 * np.sin(1.1 * t)
    course = 0.4 + np.cumsum(0.05 * np.ones(len(t)) * 0.01)
    east = np.cumsum(speed * np.cos(course) * 0.01)
    north = np.cumsum(speed * np.sin(course) * 0.01)
    log = SignalLog(t, {"vx_mps": speed, "yaw_rate_radps": np.full(len(t), 0.05)})
    rows = np.arange(0, len(t), 20)
    radius = 6_371_000.0
    fixes = {
        "stamp_s": 1_700_000_000.0 + t[rows],
        "latitude_deg": 49.0 + np.degrees(north[rows] / radius),
        "longitude_deg": 8.0 + np.degrees(east[rows] / radius / np.cos(np.radians(49.0))),
        "speed_mps": speed[rows],
        "course_deg": 90.0 - np.degrees(course[rows]),
        "hdop": np.full(len(rows), 0.9),
    }
    return log, fixes


def true_course(stamps: np.ndarray) -> np.ndarray:
    return 0.4 + 0.05 * (stamps + 0.01)


def test_clocks_are_brought_together_by_the_speed() -> None:
    log, fixes = drive()
    joined = join_receiver(log, fixes)
    assert joined.offset_s == pytest.approx(-1_700_000_000.0, abs=0.02)
    rows = np.flatnonzero(np.isfinite(joined.log.columns["course_rad"]))
    assert joined.fixes == len(rows) > 290
    off = joined.log.columns["course_rad"][rows] - true_course(log.stamp_s[rows])
    assert np.abs(off).max() < 2e-3  # 0.02 s of 0.05 rad/s
    assert joined.log.kinds() >= {"gps"}


def test_stamps_that_overlap_stay() -> None:
    log, fixes = drive()
    fixes["stamp_s"] = fixes["stamp_s"] - 1_700_000_000.0
    assert join_receiver(log, fixes).offset_s == 0.0


def test_courses_come_from_positions_where_there_are_none() -> None:
    log, fixes = drive()
    fixes["stamp_s"] = fixes["stamp_s"] - 1_700_000_000.0
    del fixes["course_deg"], fixes["speed_mps"]
    joined = join_receiver(log, fixes)
    rows = np.flatnonzero(np.isfinite(joined.log.columns["course_rad"]))
    assert joined.from_positions == len(rows) > 290
    off = joined.log.columns["course_rad"][rows] - true_course(log.stamp_s[rows])
    assert np.abs(off).max() < 2e-3
    # known only with the later of both positions
    late = joined.log.columns["gnss_arrival_s"][rows] - log.stamp_s[rows]
    assert late == pytest.approx(0.1, abs=0.011)
    speed = joined.log.columns["speed_mps"][rows] - log.columns["vx_mps"][rows]
    assert np.abs(speed).max() < 0.1


def test_fixes_of_few_satellites_are_left_out() -> None:
    log, fixes = drive()
    fixes["hdop"][:50] = 9.0
    assert join_receiver(log, fixes).left_out == 50
    fixes["hdop"][:] = 9.0
    with pytest.raises(InputError, match="0 fixes with HDOP up to 5, 3 are needed"):
        join_receiver(log, fixes)


def test_what_cannot_be_joined_is_said() -> None:
    log, fixes = drive()
    with pytest.raises(InputError, match="of its own"):
        join_receiver(SignalLog(log.stamp_s, {"course_rad": log.stamp_s}), fixes)
    with pytest.raises(InputError, match="without vx_mps no offset"):
        join_receiver(SignalLog(log.stamp_s, {"ay_mps2": log.stamp_s}), fixes)
    noise = np.random.default_rng(0).uniform(0.0, 30.0, len(fixes["stamp_s"]))
    with pytest.raises(InputError, match="fits the wheels nowhere"):
        join_receiver(log, {**fixes, "speed_mps": noise})
    still = {**fixes, "latitude_deg": np.full(len(noise), 49.0)}
    still["longitude_deg"] = np.full(len(noise), 8.0)
    del still["course_deg"]
    with pytest.raises(InputError, match="0 of 300 fixes have or give a course"):
        join_receiver(log, still)
