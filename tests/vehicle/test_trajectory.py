"""Poses between poses, and parts of a trajectory."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.vehicle.trajectory import Trajectory, interpolate_poses


def test_poses_between_go_the_short_way_round() -> None:
    poses = np.array([[0.0, 0.0, 3.1], [2.0, 4.0, -3.1]])
    found = interpolate_poses(np.array([0.0, 1.0]), poses, [0.5])
    assert found[0, :2] == pytest.approx([1.0, 2.0])
    assert abs(found[0, 2]) == pytest.approx(np.pi)


def test_at_a_stamp_stands_its_pose_to_the_bit_even_beside_a_gap() -> None:
    stamps = np.array([0.0, 0.1, 5.0, 5.1])
    poses = np.random.default_rng(1).uniform(-3.0, 3.0, (4, 3))
    assert np.array_equal(interpolate_poses(stamps, poses, stamps), poses)


def test_outside_and_in_gaps_there_is_no_pose() -> None:
    stamps, poses = np.array([0.0, 1.0, 3.0]), np.zeros((3, 3))
    known = np.isfinite(interpolate_poses(stamps, poses, [-0.1, 0.5, 2.0, 3.1])[:, 0])
    assert known.tolist() == [False, True, False, False]
    assert np.isfinite(interpolate_poses(stamps, poses, [2.0], max_gap_s=3.0)).all()
    assert np.isnan(interpolate_poses(np.empty(0), np.empty((0, 3)), [1.0])).all()


def test_parts_keep_stamps_poses_and_covariances_together() -> None:
    stamps = np.arange(10.0)
    track = Trajectory(stamps, np.outer(stamps, [1.0, 0.0, 0.0]), np.tile(np.eye(3), (10, 1, 1)))
    part = track.between(2.0, 4.0)
    assert part.stamp_s.tolist() == [2.0, 3.0, 4.0]
    assert part.covariance is not None
    assert part.covariance.shape == (3, 3, 3)
    assert track.travelled_m()[-1] == 9.0
    assert track.thinned(3.0).stamp_s.tolist() == [0.0, 3.0, 6.0, 9.0]
