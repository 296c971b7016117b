"""Added trajectories brought to ours: by nothing, the first pose, a rigid motion, the clock."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.evaluation.alignment import align
from polemap.vehicle.pose import wrap_angle
from polemap.vehicle.trajectory import Trajectory


@pytest.fixture
def goal() -> Trajectory:
    t = np.arange(0.0, 60.0, 0.05)
    speed = 8.0 + 3.0 * np.sin(2 * np.pi * t / 17.0)
    yaw = 0.5 * np.sin(2 * np.pi * t / 23.0) + 0.05 * t
    east = 1000.0 + np.cumsum(speed * np.cos(yaw)) * 0.05
    north = 2000.0 + np.cumsum(speed * np.sin(yaw)) * 0.05
    return Trajectory(t, np.column_stack([east, north, wrap_angle(yaw)]))


def _moved(track: Trajectory, turn: float, east: float, north: float) -> Trajectory:
    c, s = np.cos(turn), np.sin(turn)
    points = track.poses[:, :2] @ np.array([[c, s], [-s, c]]) + [east, north]
    return Trajectory(
        track.stamp_s, np.column_stack([points, wrap_angle(track.poses[:, 2] + turn)])
    )


@pytest.mark.parametrize("kind", ["origin", "se2"])
def test_a_rigid_motion_is_taken_away(goal: Trajectory, kind: str) -> None:
    track = _moved(goal, 1.1, -300.0, 40.0)
    aligned, text = align(track, goal, kind, "theirs")  # type: ignore[arg-type]
    assert aligned.poses == pytest.approx(goal.poses, abs=1e-6)
    assert "theirs: aligned by" in text


def test_nothing_is_done_unless_asked_for(goal: Trajectory) -> None:
    track = _moved(goal, 0.2, 5.0, 5.0)
    aligned, text = align(track, goal, "none", "theirs")
    assert aligned is track
    assert text == "theirs: not aligned"


@pytest.mark.parametrize("offset_s", [0.37, -18.0, 1.7e9])
def test_another_clock_is_found_wherever_the_track_lies(goal: Trajectory, offset_s: float) -> None:
    track = _moved(goal, 2.0, 7000.0, -3.0)
    late = Trajectory(track.stamp_s + offset_s, track.poses)
    aligned, text = align(late, goal, "time", "theirs")
    assert aligned.stamp_s == pytest.approx(goal.stamp_s, abs=0.03)
    assert "aligned by time" in text


@pytest.mark.parametrize(("kind", "offset_s"), [("time,se2", -18.0), ("time,origin", 0.37)])
def test_clock_and_motion_are_taken_away_together(
    goal: Trajectory, kind: str, offset_s: float
) -> None:
    track = _moved(goal, 2.0, 7000.0, -3.0)
    late = Trajectory(track.stamp_s + offset_s, track.poses)
    aligned, text = align(late, goal, kind, "theirs")  # type: ignore[arg-type]
    assert aligned.stamp_s == pytest.approx(goal.stamp_s, abs=2e-3)
    off = np.hypot(*(aligned.poses - goal.poses)[:, :2].T)
    assert np.median(off) < 0.03
    assert f"stamps less {offset_s:.2f}" in text
    assert "turned -114.59" in text


def test_what_has_nothing_in_common_is_refused(goal: Trajectory) -> None:
    apart = Trajectory(goal.stamp_s + 1e4, goal.poses)
    with pytest.raises(InputError, match="shares no time"):
        align(apart, goal, "se2", "theirs")
    still = Trajectory(goal.stamp_s, np.zeros_like(goal.poses))
    with pytest.raises(InputError, match="at no shift"):
        align(still, goal, "time", "theirs")
