"""Local maps that are found again by their patterns, where nothing says where to look."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.build.slam.config import SlamConfig
from polemap.build.slam.loops import find_loops, recall_loops
from polemap.build.slam.recall import Recall, mirrored
from polemap.build.slam.submaps import Submap
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.vehicle.pose import inverse_transform_points, relative, wrap_angle

Floats = NDArray[np.float64]

STRETCH_M, REACH_M = 30.0, 20.0
WAY_M = 240.0


def street(seed: int) -> Floats:
    """Poles `(n, 2)` beside a straight way to the east, unevenly."""
    rng = np.random.default_rng(seed)
    along = np.cumsum(rng.uniform(2.0, 9.0, 60))
    along = along[along < WAY_M]
    return np.column_stack(
        [along, rng.choice([-1.0, 1.0], len(along)) * rng.uniform(4, 9, len(along))]
    )


def rows_of_trees() -> Floats:
    along = np.arange(5.0, WAY_M, 10.0)
    return np.concatenate([np.column_stack([along, np.full(len(along), y)]) for y in (-5.0, 5.0)])


def passed(points: Floats, seed: int, first: int, poses: Floats) -> list[Submap]:
    """Local maps of a pass along the way: of each stretch what was seen, from `poses` `(n, 3)`."""
    rng = np.random.default_rng(seed)
    made = []
    for number, pose in enumerate(poses):
        near = np.flatnonzero(np.abs(points[:, 0] - pose[0]) < 0.5 * STRETCH_M + REACH_M)
        near = near[rng.random(len(near)) < 0.85]
        seen = inverse_transform_points(pose, points[near])
        seen = seen + 0.08 * rng.standard_normal(seen.shape)
        way = np.column_stack([np.linspace(-0.5, 0.5, 15) * STRETCH_M, np.zeros(15)])
        made.append(
            Submap(
                route=0, anchor=first + number, landmark=1000 * (first + number) + near,
                points_m=seen, width_m=np.full(len(near), 0.3),
                kind=np.full(len(near), LandmarkKind.POLE, dtype=np.int8), way_m=way,
                reach_m=REACH_M,
            )
        )  # fmt: skip
    return made


def anchors(shift_m: float = 0.0) -> Floats:
    east = np.arange(0.5 * STRETCH_M, WAY_M, STRETCH_M)
    return np.column_stack([east, np.full(len(east), shift_m), np.zeros(len(east))])


def lost(n: int, sd_m: float = 40.0) -> Floats:
    """Covariance of anchors of which the second half has drifted away together."""
    covariance = np.zeros((3 * n, 3 * n))
    for axis, sd in enumerate((sd_m, sd_m, 0.3)):
        rows = 3 * np.arange(n // 2, n) + axis
        covariance[np.ix_(rows, rows)] = sd**2
    return covariance + 1e-4 * np.eye(3 * n)


def twice(first: Floats, second: Floats) -> tuple[list[Submap], Floats, Floats]:
    """Two passes, the second believed to be 60 m aside; believed anchors and their covariance."""
    submaps = [*passed(first, 1, 0, anchors()), *passed(second, 2, 100, anchors())]
    believed = np.concatenate([anchors(), anchors(60.0)])
    return submaps, believed, lost(len(submaps))


def test_a_pass_is_found_again_where_the_graph_does_not_know_where_to_look() -> None:
    submaps, believed, covariance = twice(street(5), street(5))
    waiting = find_loops(submaps, believed, covariance, SlamConfig())
    assert waiting.unreached
    assert not waiting.loops
    found = recall_loops(submaps, believed, covariance, SlamConfig())
    assert len(found.loops) >= 6
    for loop in found.loops:
        assert abs(loop.second - len(anchors()) - loop.first) <= 1
        assert np.ptp(loop.landmarks % 1000, axis=1).max() == 0  # both are one pole of the street
    pairs = {(loop.first, loop.second) for loop in found.loops}
    again = recall_loops(submaps, believed, covariance, SlamConfig(), known=pairs)
    assert not pairs & {(loop.first, loop.second) for loop in again.loops}


def test_the_pose_of_what_is_found_is_right() -> None:
    poses = anchors()
    turned = np.array([80.0, 3.0, 2.5])
    submaps = passed(street(6), 1, 0, poses)
    (again,) = passed(street(6), 3, 50, turned[np.newaxis])
    found = Recall(submaps).find(again)
    best = found.poses[0] - relative(poses[found.other[0]], turned)
    assert np.hypot(*best[:2]) < 0.5
    assert abs(wrap_angle(best[2])) < 0.03


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (rows_of_trees(), rows_of_trees()),
        (street(5), street(7)),
        (street(5), street(5) * np.array([1.0, -1.0])),
        (street(5), np.empty((0, 2))),
        (street(5)[:2], street(5)),
    ],
    ids=["equal avenues", "another street", "mirrored street", "nothing seen", "two poles"],
)
def test_what_is_elsewhere_or_could_be_is_no_loop(first: Floats, second: Floats) -> None:
    submaps, believed, covariance = twice(first, second)
    assert not recall_loops(submaps, believed, covariance, SlamConfig()).loops


def test_streets_that_repeat_one_pattern_are_left_open() -> None:
    """The second pass fits two streets of the first alike."""
    one = street(5)
    first = passed(one, 1, 0, anchors())
    copy = passed(one, 4, 50, anchors())
    second = passed(one, 2, 100, anchors())
    submaps = [*first, *copy, *second]
    believed = np.concatenate([anchors(), anchors(300.0), anchors(60.0)])
    n = len(anchors())
    covariance = np.zeros((9 * n, 9 * n))
    covariance[6 * n :, 6 * n :] = lost(2 * n, 300.0)[3 * n :, 3 * n :]
    found = recall_loops(submaps, believed, covariance + 1e-4 * np.eye(9 * n), SlamConfig())
    assert not [loop for loop in found.loops if loop.second >= 2 * n]
    assert found.ambiguous > 0


def test_the_mirror_image_is_as_regular_and_stands_nowhere() -> None:
    submaps = passed(street(5), 1, 0, anchors())
    image = mirrored(submaps[3])
    np.testing.assert_array_equal(image.points_m[:, 1], -submaps[3].points_m[:, 1])
    found = Recall(submaps).find(image)
    assert not len(found) or found.votes.max() < Recall(submaps).find(submaps[3]).votes.max() / 2
