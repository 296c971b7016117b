"""Corners that face another way are other corners, wherever the circle is cut."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.drivelog.detections import Detections, pole_detections
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.localize.config import LocalizeConfig
from polemap.localize.particle_filter.landmarks import FACING_COLUMN
from polemap.localize.particle_filter.pole_weigher import PoleWeigher
from polemap.map.pole_map import KIND_COLUMN, PoleMap
from tests.pole_maps import plain_map

POINTS = np.array([[10.0, 4.0], [14.0, -5.0], [18.0, 6.0], [22.0, -4.0]])


def corner_map(facing: np.ndarray) -> PoleMap:
    made = plain_map(POINTS)
    kind = np.full(len(POINTS), LandmarkKind.CORNER, dtype=np.int8)
    return replace(made, extra={KIND_COLUMN: kind, FACING_COLUMN: facing})


def seen(facing: np.ndarray, pose: np.ndarray) -> Detections:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    local = (POINTS - pose[:2]) @ np.array([[c, -s], [s, c]])
    scan = pole_detections(0.0, 0.0, local, np.tile(0.01 * np.eye(2), (len(local), 1, 1)))
    kind = np.full(len(local), LandmarkKind.CORNER, dtype=np.int8)
    return scan.with_columns(kind=kind, facing_rad=facing - pose[2], width_m=np.full(4, np.nan))


@pytest.mark.parametrize("turn_rad", [0.0, 1.0, 2.6, -3.1])
def test_sides_decide_however_the_street_lies(turn_rad: float) -> None:
    facing = turn_rad + np.array([0.0, np.pi, 0.2, np.pi / 2])
    pose = np.array([0.0, 0.0, 0.1])
    weigher = PoleWeigher(corner_map(facing), LocalizeConfig())
    scan = seen(facing + np.array([0.2, -0.2, 0.1, 2.0 * np.pi]), pose)
    landmarks = weigher.near(pose[None], scan)
    assert weigher.match(pose, scan, landmarks).assignment.tolist() == [0, 1, 2, 3]
    turned = seen(facing + np.array([0.2, np.pi, 0.1, -np.pi / 2]), pose)
    assert weigher.match(pose, turned, landmarks).assignment.tolist() == [0, -1, 2, -1]


def test_an_unknown_side_is_no_reason_against() -> None:
    pose = np.zeros(3)
    weigher = PoleWeigher(corner_map(np.array([0.0, np.nan, 1.0, 2.0])), LocalizeConfig())
    scan = seen(np.array([0.0, 1.0, np.nan, 2.0]), pose)
    landmarks = weigher.near(pose[None], scan)
    assert weigher.match(pose, scan, landmarks).assignment.tolist() == [0, 1, 2, 3]


def test_corners_that_face_everywhere_are_matched_by_place() -> None:
    facing = np.arange(4) * np.pi / 2
    around = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    points = np.vstack([POINTS, np.column_stack([40.0 + np.arange(12), np.full(12, 30.0)])])
    made = plain_map(points)
    extra = {
        KIND_COLUMN: np.full(16, LandmarkKind.CORNER, dtype=np.int8),
        FACING_COLUMN: np.concatenate([facing, around]),
    }
    weigher = PoleWeigher(replace(made, extra=extra), LocalizeConfig())
    pose = np.zeros(3)
    scan = seen(facing + 0.25, pose)
    landmarks = weigher.near(np.array([[0.0, 0.0, 0.0], [40.0, 30.0, 0.0]]), scan)
    assert weigher.match(pose, scan, landmarks).assignment.tolist() == [0, 1, 2, 3]


def test_poses_of_many_headings_are_weighed_as_each_alone() -> None:
    facing = np.array([0.0, np.pi, 0.2, np.pi / 2])
    weigher = PoleWeigher(corner_map(facing), LocalizeConfig())
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.normal(0, 2, (40, 2)), rng.uniform(-np.pi, np.pi, 40)])
    scan = seen(facing, np.zeros(3))
    landmarks = weigher.near(poses, scan)
    together = weigher.weigh(poses, scan, landmarks).log_likelihood
    alone = [weigher.weigh(pose[None], scan, landmarks).log_likelihood[0] for pose in poses]
    # a side that is off by half a step of the turns makes a difference that its deviation allows
    np.testing.assert_allclose(together, alone, atol=1.5)
