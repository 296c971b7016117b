"""What is left out: manoeuvres that were steered, U-turns, and what the user says."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from polemap.drivelog.errors import ConfigError
from polemap.evaluation.exclusions import (
    evasive_manoeuvres,
    excluded_mask,
    other_lanes,
    parse_interval,
    start_up_exclusions,
    u_turns,
    user_exclusions,
)
from polemap.evaluation.laps import find_stretches
from polemap.evaluation.meanpath import MeanPath
from polemap.evaluation.repeatability import crossings, guides_of
from polemap.vehicle.trajectory import Trajectory

Maker = Callable[..., Any]


def judged(track: Trajectory) -> tuple[Any, Any]:
    (stretch,) = find_stretches([track])
    return stretch, crossings(stretch, [track], guides_of(stretch, [track]))


@pytest.mark.parametrize("seed", range(4))
def test_a_swerve_is_found_and_nothing_else(drive_course: Maker, seed: int) -> None:
    track = drive_course(seed, sd=0.15, swerve=(2, 150.0, 2.5), rate_hz=10.0).truth
    (found,) = evasive_manoeuvres(*judged(track))
    assert found.pass_row == 2
    assert found.start_m < 150.0 < found.end_m
    assert found.end_m - found.start_m < 90.0


@pytest.mark.parametrize("seed", range(6))
def test_ordinary_driving_is_kept(drive_course: Maker, seed: int) -> None:
    track = drive_course(seed, sd=0.15, correlation_m=12.0, rate_hz=10.0).truth
    assert evasive_manoeuvres(*judged(track)) == []


def test_a_jump_of_the_localizer_is_kept(drive_course: Maker) -> None:
    """The same excursion without the heading that would drive it is an error, and counts."""
    track = drive_course(1, sd=0.1, rate_hz=10.0).truth
    steered = drive_course(1, sd=0.1, swerve=(2, 150.0, 2.5), rate_hz=10.0).truth
    jumped = steered.poses.copy()
    jumped[:, 2] = track.poses[:, 2]
    assert len(evasive_manoeuvres(*judged(steered))) == 1
    assert evasive_manoeuvres(*judged(Trajectory(track.stamp_s, jumped))) == []


def test_two_laps_cannot_tell_who_swerved(drive_course: Maker) -> None:
    track = drive_course(0, laps=2, swerve=(1, 150.0, 2.5), rate_hz=10.0).truth
    assert evasive_manoeuvres(*judged(track)) == []


def test_u_turn() -> None:
    angle = np.linspace(-np.pi / 2, np.pi / 2, 60)
    turn = np.column_stack([100.0 + 6.0 * np.cos(angle), 6.0 * np.sin(angle)])
    straight = np.arange(0.0, 99.0, 2.0)[:, None]
    way = np.concatenate([straight * (1, 0) - (0, 6), turn, straight[::-1] * (1, 0) + (0, 6)])
    ((start, end),) = u_turns(MeanPath.through(way))
    assert start < 100.0
    assert end > 100.0 + 6.0 * np.pi
    assert end - start < 70.0


def test_a_street_corner_is_no_u_turn() -> None:
    corner = np.array(
        [(0.0, 0.0), (80.0, 0.0), (90.0, 2.0), (98.0, 10.0), (100.0, 20.0), (100.0, 90.0)]
    )
    assert u_turns(MeanPath.through(corner)) == []


def test_user_intervals(drive_course: Maker) -> None:
    stretch, crossed = judged(drive_course(0, laps=3, rate_hz=10.0).truth)
    by_time = parse_interval("60:65")
    by_place = parse_interval("campus/120m:180m")
    elsewhere = parse_interval("avenue/1:2")
    found = user_exclusions([stretch], [crossed], [by_time, by_place, elsewhere], "campus")
    assert [one.pass_row for one in found] == [1, None]
    assert found[0].end_m - found[0].start_m == pytest.approx(5.0 * 8.0, abs=1.5)
    mask = excluded_mask(stretch, 0, found)
    station = stretch.path.station_m
    by_all = (station >= 120.0) & (station <= 180.0)
    by_one = (station >= found[0].start_m) & (station <= found[0].end_m)
    assert np.array_equal(mask[0], by_all)
    assert np.array_equal(mask[1], by_all | by_one)


@pytest.mark.parametrize("text", ["", "5", "5:4", "a:b", "3m:4", "nan:2", "1:2:3"])
def test_intervals_that_make_no_sense(text: str) -> None:
    with pytest.raises(ConfigError, match="--exclude"):
        parse_interval(text)


def moved_aside(track: Trajectory, start_s: float, end_s: float, left_m: float) -> Trajectory:
    poses = track.poses.copy()
    inside = (track.stamp_s >= start_s) & (track.stamp_s <= end_s)
    poses[inside, 0] -= left_m * np.sin(poses[inside, 2])
    poses[inside, 1] += left_m * np.cos(poses[inside, 2])
    return Trajectory(track.stamp_s, poses)


def test_another_lane_needs_two_witnesses(drive_course: Maker) -> None:
    """3.5 m to the left for 10 s of the second of three laps."""
    same = drive_course(0, laps=3, sd=0.1, rate_hz=10.0).truth
    other = moved_aside(same, 60.0, 70.0, 3.5)
    (stretch,) = find_stretches([same])
    guides = guides_of(stretch, [same])
    plain, aside = (crossings(stretch, [track], guides) for track in (same, other))
    (found,) = other_lanes(stretch, aside, aside)
    assert found.pass_row == 1
    assert found.end_m - found.start_m == pytest.approx(80.0, abs=3.0)
    # A localizer that alone claims it is wrong, and that counts; so does a reference alone.
    assert other_lanes(stretch, plain, aside) == []
    assert other_lanes(stretch, aside, plain) == []


def test_start_up_is_left_out(drive_course: Maker) -> None:
    stretch, crossed = judged(drive_course(0, laps=3, rate_hz=10.0).truth)
    (found,) = start_up_exclusions([stretch], [crossed], [5.0])
    assert found.pass_row == 0
    assert found.end_m - found.start_m == pytest.approx(40.0, abs=2.0)
