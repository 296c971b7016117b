"""Laps and passes are found in the track, or taken from laps.csv where these are laps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from polemap.drivelog.readers.registry import open_drive
from polemap.evaluation.laps import Span, find_stretches, road_length_m
from polemap.evaluation.meanpath import REACH_M
from polemap.vehicle.trajectory import Trajectory

Maker = Callable[..., Any]


def street(points: list[tuple[float, float]], speed_mps: float = 8.0) -> Trajectory:
    """Drive along straight lines at 10 Hz."""
    corners = np.array(points, dtype=float)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    distance = np.arange(0.0, length[-1], speed_mps / 10.0)
    x, y = (np.interp(distance, length, corners[:, i]) for i in (0, 1))
    yaw = np.arctan2(np.gradient(y), np.gradient(x))
    return Trajectory(np.arange(len(distance)) / 10.0, np.column_stack([x, y, yaw]))


@pytest.mark.parametrize("laps", [2, 5, 8])
def test_closed_course(drive_course: Maker, course: Any, laps: int) -> None:
    (stretch,) = find_stretches([drive_course(laps, laps=laps, rate_hz=10.0).truth])
    assert len(stretch.passes) == laps
    assert stretch.whole_laps
    assert stretch.path.length_m == pytest.approx(course.length_m, abs=10.0)
    starts = np.array([one.start_s for one in stretch.passes]) * 8.0 / course.length_m
    assert np.allclose(starts, np.arange(laps), atol=0.05)


def test_both_directions_of_a_street_are_two_roads() -> None:
    there_and_back = [(0.0, 0.0), (200.0, 0.0), (200.0, 4.0), (0.0, 4.0), (0.0, 0.0)]
    stretches = find_stretches([street(there_and_back * 3)])
    assert all(len(one.passes) >= 2 for one in stretches)
    headings = [
        float(one.path.heading_rad(np.array([one.path.length_m / 3]))[0]) for one in stretches
    ]
    assert sum(one.path.length_m for one in stretches) == pytest.approx(400.0, abs=60.0)
    assert headings


def test_a_tour_has_only_its_shared_streets() -> None:
    """Two passes over AB with different ways back; CD is driven once."""
    first = [(0.0, 0.0), (150.0, 0.0), (150.0, 100.0), (0.0, 100.0), (0.0, 0.0)]
    second = [(150.0, 0.0), (150.0, -90.0), (300.0, -90.0)]
    (stretch,) = find_stretches([street(first + second)])
    assert len(stretch.passes) == 2
    assert stretch.path.length_m == pytest.approx(150.0, abs=20.0)


def test_nothing_is_driven_twice() -> None:
    assert find_stretches([street([(0.0, 0.0), (300.0, 0.0), (300.0, 300.0)])]) == []


def test_crossing_ones_own_track_is_no_pass() -> None:
    loop = [(0.0, 0.0), (200.0, 0.0), (200.0, 100.0), (100.0, 100.0), (100.0, -100.0)]
    assert find_stretches([street(loop)]) == []


def test_named_laps_are_used(drive_course: Maker, course: Any) -> None:
    track = drive_course(1, laps=4, rate_hz=10.0).truth
    lap_s = course.length_m / 8.0
    named = [Span(0, k * lap_s, (k + 1) * lap_s, name) for k, name in enumerate("abcd")]
    (stretch,) = find_stretches([track], named)
    assert [one.name for one in stretch.passes] == ["a", "b", "c", "d"]
    assert stretch.path.length_m == pytest.approx(course.length_m, abs=4.0)


def test_named_parts_of_different_courses_are_not_laps(drive_course: Maker, course: Any) -> None:
    """As in a recording whose laps.csv splits it into 'map' and 'test'."""
    track = drive_course(1, laps=3, rate_hz=10.0).truth
    lap_s = course.length_m / 8.0
    named = [Span(0, 0.0, 0.4 * lap_s, "map"), Span(0, 0.45 * lap_s, 0.9 * lap_s, "test")]
    (stretch,) = find_stretches([track], named)
    assert len(stretch.passes) == 3


def test_laps_in_several_recordings(drive_course: Maker) -> None:
    tracks = [drive_course(seed, laps=1, rate_hz=10.0).truth for seed in range(3)]
    (stretch,) = find_stretches(tracks)
    assert [one.source for one in stretch.passes] == [0, 1, 2]


def test_road_length_counts_a_road_once(drive_course: Maker, course: Any) -> None:
    length = road_length_m([drive_course(0, laps=3, rate_hz=10.0).truth])
    assert length == pytest.approx(course.length_m, abs=12.0)


def test_streets_of_victoria_park(recording: Any) -> None:
    """A real tour: laps.csv names two halves, not laps; the shared streets are found."""
    drive = open_drive(recording("victoria_park/drive"))
    assert drive.reference is not None
    track = Trajectory(drive.reference.stamp_s, drive.reference.poses)
    named = [Span(0, lap.start_s, lap.end_s, lap.name) for lap in drive.laps]
    stretches = find_stretches([track], named)
    assert len(stretches) >= 8
    assert sum(one.path.length_m for one in stretches) > 800.0
    assert max(len(one.passes) for one in stretches) >= 4
    for one in stretches:
        for lap in one.passes:
            part = track.between(lap.start_s, lap.end_s).poses[:, :2]
            away = np.min(np.hypot(*(part[:, None] - one.path.points_m[::4]).T), axis=0)
            assert np.median(away) < REACH_M
