"""Odometry between the stamps of two frames."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.drivelog.odometry_window import OdometryWindow
from polemap.drivelog.samples import OdometrySample
from polemap.track.frame_motion import KEEP_S, motion_between

Floats = NDArray[np.float64]


def _odometry(stamps: Floats, speed: float, rate: float) -> OdometryWindow:
    history = OdometryWindow(KEEP_S)
    for stamp in stamps:
        history.insert(OdometrySample(float(stamp), float(stamp), speed, rate))
    return history


def test_odometry_between_stamps_is_the_arc() -> None:
    history = _odometry(np.arange(0, 2, 0.02), 8.0, 0.3)
    motion = motion_between(history, 0.5, 1.25)
    assert motion is not None
    turn = 0.3 * 0.75
    assert motion.turn_rad == pytest.approx(turn)
    assert motion.forward_m == pytest.approx(8.0 / 0.3 * np.sin(turn), abs=1e-6)
    assert motion.left_m == pytest.approx(8.0 / 0.3 * (1 - np.cos(turn)), abs=1e-6)


def test_odometry_with_a_hole_or_running_back_says_nothing() -> None:
    stamps = np.concatenate([np.arange(0, 1, 0.02), np.arange(4, 5, 0.02)])
    history = _odometry(stamps, 8.0, 0.0)
    assert motion_between(history, 0.5, 4.5) is None
    assert motion_between(history, 0.8, 0.5) is None
    assert motion_between(history, 4.2, 4.4) is not None
    assert motion_between(OdometryWindow(KEEP_S), 0.0, 0.1) is None


def test_late_doubled_and_broken_odometry_finds_its_place() -> None:
    history = _odometry(np.array([0.0, 0.2, 0.1, 0.2]), 5.0, 0.0)
    history.insert(OdometrySample(0.15, 0.15, np.nan, 0.0))
    motion = motion_between(history, 0.0, 0.2)
    assert motion is not None
    assert motion.forward_m == pytest.approx(1.0)


def test_recent_odometry_says_what_all_of_it_says() -> None:
    rng = np.random.default_rng(8)
    stamps = np.cumsum(rng.choice([0.01, 0.02, 0.9, 1.3], 400, p=[0.5, 0.46, 0.03, 0.01]))
    speed, rate = rng.uniform(0, 15, 400), rng.uniform(-0.5, 0.5, 400)
    window = OdometryWindow(keep_s=1e3)
    for row in zip(stamps, stamps, speed, rate, strict=True):
        window.insert(OdometrySample(*map(float, row)))
    moved = 0
    for start in rng.uniform(-0.5, stamps[-1] + 0.5, 200):
        end = start + rng.uniform(0.0, 1.5)
        motion = motion_between(window, start, end)
        inside = stamps[(stamps > start - 1.0) & (stamps < end + 1.0)]
        if not len(inside) or np.diff(np.r_[start, inside, end]).max() > 1.0:
            assert motion is None
            continue
        assert motion is not None
        moved += 1
        knots = np.r_[start, stamps[(stamps > start) & (stamps < end)], end]
        pose, heading = np.zeros(2), 0.0
        for one, two in pairwise(knots):
            half = 0.5 * np.interp(0.5 * (one + two), stamps, rate) * (two - one)
            chord = (
                np.interp(0.5 * (one + two), stamps, speed) * (two - one) * np.sinc(half / np.pi)
            )
            pose = pose + chord * np.array([np.cos(heading + half), np.sin(heading + half)])
            heading += 2.0 * half
        got = (motion.forward_m, motion.left_m, motion.turn_rad)
        assert got == pytest.approx((*pose, heading), rel=1e-9, abs=1e-9)
    assert 50 < moved < 200
