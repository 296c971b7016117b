"""The bound against a least-squares fit that reaches it, and what thin maps do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.detect.config import DetectionConfig
from polemap.detect.visibility import camera_sector
from polemap.drivelog.detections import VisibleRegion, pole_detections
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.evaluation.localizability import (
    HEADING_SD_RAD,
    HELD_SD_M,
    PLACE_SD_M,
    SensorModel,
    camera_sensor,
    held_shares,
    localizability,
    scans_sensor,
)
from polemap.localize.particle_filter.line_model import KIND_MODELS
from polemap.map.pole_map import PoleMap
from polemap.stereo.rig import Mounting, StereoRig
from tests.localize.particle_filter.test_line_model import ORIGIN_M, line_map
from tests.polemap.map.test_map_io import LOCAL, make_map

VIEW = VisibleRegion(np.array([0.0, 0.0]), -0.7, 0.7, 1.0, np.array([40.0]))
SENSOR = camera_sensor(VIEW, 720.0, 0.54, 0.7)


def poles(points: list[tuple[float, float]]) -> PoleMap:
    n = len(points)
    return replace(
        make_map(LOCAL, n),
        points_m=np.array(points),
        covariance_m2=np.tile(np.eye(2) * 1e-4, (n, 1, 1)),
        existence=np.ones(n),
        _tree=None,
    )


def test_the_bound_is_reached_by_least_squares() -> None:
    """2000 noisy looks at five poles, each solved for the pose; sd within its sampling error."""
    points = [(10.0, 4.0), (15.0, -5.0), (22.0, 6.0), (30.0, -4.0), (12.0, -3.0)]
    pole_map = poles(points)
    sure = replace(SENSOR, p_detection=1.0)
    bound = localizability(pole_map, np.zeros((1, 3)), sure)
    rng = np.random.default_rng(0)
    true = np.array(points)
    spread = SENSOR.covariance(true) + 1e-4 * np.eye(2)
    root = np.linalg.cholesky(spread)
    weight = np.linalg.inv(spread)
    jacobian = np.zeros((5, 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = -1.0
    jacobian[:, 0, 2], jacobian[:, 1, 2] = true[:, 1], -true[:, 0]
    normal = np.einsum("nij,nik,nkl->jl", jacobian, weight, jacobian)
    noise = np.einsum("nij,knj->kni", root, rng.standard_normal((2000, 5, 2)))
    fits = np.linalg.solve(normal, np.einsum("nij,nil,knl->jk",
                                             jacobian, weight, noise))  # fmt: skip
    sd = fits.std(axis=1)
    tolerance = 4.0 / np.sqrt(2 * 2000)
    assert bound.longitudinal_sd_m[0] == pytest.approx(sd[0], rel=tolerance)
    assert bound.lateral_sd_m[0] == pytest.approx(sd[1], rel=tolerance)
    assert bound.yaw_sd_rad[0] == pytest.approx(sd[2], rel=tolerance)
    assert bound.poles_in_view[0] == pytest.approx(5.0)


def test_thin_places_show() -> None:
    pole_map = poles([(10.0, 4.0), (15.0, -5.0), (22.0, 6.0)])
    poses = np.array([[0.0, 0.0, 0.0], [17.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
    bound = localizability(pole_map, poses, SENSOR)
    assert bound.lateral_sd_m[0] < 0.2
    # a single pole bounds nothing by itself, no pole neither
    assert np.isinf(bound.lateral_sd_m[2])
    assert np.isinf(bound.yaw_sd_rad[2])
    assert bound.poles_in_view.tolist() == pytest.approx([2.1, 0.0, 0.0])


def test_more_poles_never_hurt_and_range_does() -> None:
    few = poles([(10.0, 4.0), (15.0, -5.0)])
    more = poles([(10.0, 4.0), (15.0, -5.0), (20.0, 2.0)])
    far = poles([(30.0, 12.0), (35.0, -5.0)])
    found = [localizability(m, np.zeros((1, 3)), SENSOR) for m in (more, few, far)]
    along = [one.longitudinal_sd_m[0] for one in found]
    across = [one.lateral_sd_m[0] for one in found]
    assert along == sorted(set(along))
    assert across == sorted(set(across))


def test_what_was_known_before_stays_where_no_pole_tells() -> None:
    prior = (10.0, 0.2)
    alone = localizability(poles([(0.0, 500.0)]), np.zeros((1, 3)), SENSOR, prior_sd=prior)
    assert alone.lateral_sd_m[0] == pytest.approx(10.0)
    assert alone.yaw_sd_rad[0] == pytest.approx(0.2)
    # a single pole tells the place as well as the heading is known
    one = localizability(poles([(20.0, 0.0)]), np.zeros((1, 3)), SENSOR, prior_sd=prior)
    assert one.lateral_sd_m[0] == pytest.approx(20.0 * 0.2, rel=0.1)
    assert one.longitudinal_sd_m[0] < 0.5


def test_turning_the_world_changes_nothing() -> None:
    points = np.array([(8.0, 4.0), (14.0, -5.0)])
    angle = 2.1
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    before = localizability(poles([tuple(p) for p in points]), np.zeros((1, 3)), SENSOR)
    turned = np.array([[0.0, 0.0, angle]])
    after = localizability(poles([tuple(p) for p in points @ turn]), turned, SENSOR)
    for name in ("lateral_sd_m", "longitudinal_sd_m", "yaw_sd_rad"):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name))


def test_a_route_is_thinned_by_its_way_not_by_its_poses() -> None:
    # standing, then slow, then fast: 30 m in all
    east = np.concatenate([np.zeros(50), np.arange(0.0, 10.0, 0.1), np.arange(10.0, 31.0, 3.0)])
    poses = np.column_stack([east, np.zeros_like(east), np.zeros_like(east)])
    found = localizability(poles([(10.0, 4.0)]), poses, SENSOR, step_m=4.0)
    np.testing.assert_allclose(found.distance_m, found.poses[:, 0])
    assert found.distance_m[0] == 0.0
    np.testing.assert_array_equal(np.floor(found.distance_m / 4.0), np.arange(8))


def test_the_model_of_stated_errors_is_what_was_stated() -> None:
    true = SensorModel(VIEW, 0.6, 0.05, 0.002, 0.03, 0.004)
    rng = np.random.default_rng(0)
    scans = []
    for k in range(5):
        points = np.column_stack([rng.uniform(4.0, 30.0, 8), rng.uniform(-6.0, 6.0, 8)])
        n = len(points)
        scans.append(
            pole_detections(
                0.1 * k,
                0.1 * k,
                points,
                true.covariance(points),
                width_m=np.full(n, 0.2),
                view=VIEW,
            )
        )
    found = scans_sensor(tuple(scans), 0.6)
    assert found is not None
    for name in ("along_m", "along_per_m2", "across_m", "across_rad"):
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=1e-6)
    assert scans_sensor(tuple(replace(scan, view=None) for scan in scans), 0.6) is None


def test_a_camera_sees_what_falls_into_its_picture() -> None:
    rig = StereoRig(1242, 375, 720.0, 610.0, 173.0, 0.54, Mounting(1.7, 0.1, 1.6, yaw_rad=0.2))
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-10, 30, 2000), rng.uniform(-20, 20, 2000)])
    column = rig.project(np.column_stack([points, np.full(2000, 1.6)]))[:, 0]
    distance = np.hypot(*(points - (1.7, 0.1)).T)
    shown = (
        (column > 6.0)
        & (column < 1235.0)
        & (distance > 3.0)
        & (distance < DetectionConfig().range_max_m)
    )
    assert 100 < shown.sum() < 1000
    np.testing.assert_array_equal(camera_sector(rig, DetectionConfig()).contains(points), shown)


def test_a_line_beside_the_car_holds_it_aside_and_nothing_along() -> None:
    kerb = int(LandmarkKind.KERB)
    street = line_map([np.array([[0.0, 3.0], [60.0, 3.0]]) - ORIGIN_M], [kerb], sd_m=0.05)
    street = replace(street, frame=LOCAL)
    alone = replace(PoleMap.empty(LOCAL), lines=street)
    sensor = replace(SENSOR, line_sd={kerb: (0.07, 0.01)})
    poses = np.array([[10.0, 0.0, 0.0], [20.0, 0.0, 0.03], [80.0, 0.0, 0.0]])
    one = localizability(alone, poses, sensor).by_kind[LandmarkKind.KERB]
    model = KIND_MODELS[kerb]
    weight = model.detection * 0.9
    across = weight / (0.07**2 + model.floor_m**2 + 0.05**2)
    turn = weight / (0.01**2 + model.floor_rad**2) + HEADING_SD_RAD**-2.0
    # what the turn leaves unknown moves the piece, 8 m ahead, aside
    assert one.lateral_sd_m[0] == pytest.approx(np.sqrt(1.0 / across + 8.0**2 / turn), rel=0.01)
    assert one.expected.tolist() == pytest.approx([weight, weight, 0.0])
    assert one.longitudinal_sd_m == pytest.approx(PLACE_SD_M, rel=0.01)
    both = replace(poles([(25.0, 4.0)]), lines=street)
    with_pole = localizability(both, poses, sensor, prior_sd=(np.inf, HEADING_SD_RAD))
    assert list(with_pole.by_kind) == [LandmarkKind.POLE, LandmarkKind.KERB]
    pole = with_pole.by_kind[LandmarkKind.POLE]
    assert with_pole.lateral_sd_m[0] < min(pole.lateral_sd_m[0], one.lateral_sd_m[0])
    assert pole.longitudinal_sd_m[0] < HELD_SD_M
    held = {name: (aside, along) for name, aside, along in held_shares([with_pole])}
    assert held["kerb"] == pytest.approx((2 / 3, 0.0))
    assert held["pole"][1] == pytest.approx(2 / 3)
    assert held["none"] == pytest.approx((1 / 3, 1 / 3))
