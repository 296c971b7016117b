"""Pictures in the closed loop: what is dropped, how old poses are, and a short street whole."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.drivelog.errors import ConfigError
from polemap.drivelog.samples import Image, OdometrySample
from polemap.simulate.closed_loop import full_loop_study as study
from polemap.simulate.closed_loop.camera_eye import READOUT_S, CameraEye
from polemap.simulate.closed_loop.follow_run import FollowRun
from polemap.simulate.closed_loop.taught_street import (
    TaughtStreet,
    _left,
    _path_of,
    street_scenario,
    teach,
)
from polemap.simulate.plant import PlantState
from polemap.simulate.scenario import Scenario
from polemap.simulate.world import make_world
from polemap.vehicle.io import load_car
from polemap.vehicle.pose import Pose2D

if find_spec("open3d") is None:
    pytest.skip("pictures need open3d", allow_module_level=True)
pytest.importorskip("gtsam", reason="a map without reference needs gtsam")


def short_street() -> Scenario:
    """Lamps along 60 m, with a slow camera."""
    tree = street_scenario().model_dump(mode="json")
    tree["route"] |= {"corners_m": [(0.0, 0.0), (35.0, 1.0), (70.0, 0.0)]}
    tree["drive"] |= {"frame_rate_hz": 4.0, "standstill_s": 0.5}
    tree["rows"] = [
        {"kind": "lamp", "side": "both", "spacing_m": 11, "offset_m": 0.4},
        {"kind": "parked_car", "side": "right", "spacing_m": 8, "offset_m": -1.15},
    ]
    tree |= {"houses": [], "side_streets": [], "backdrop": False}
    return Scenario.model_validate(tree)


@pytest.fixture(scope="module")
def street() -> TaughtStreet:
    return teach(3, scenario=short_street(), solve=True)


class Blank(CameraEye):
    """Sees a wall: only its times are of interest."""

    def _picture(
        self, number: int, now_s: float, rear: Pose2D, state: PlantState
    ) -> tuple[Image, Image]:
        blank: NDArray[np.uint8] = np.full((480, 768), 90, dtype=np.uint8)
        return blank, blank


@pytest.mark.parametrize(
    ("processing_s", "dropped", "age_s"), [(0.0, 0, 0.0), (0.074, 4, 0.074), (0.1, 5, 0.1)]
)
def test_a_picture_that_comes_while_another_is_worked_on_is_dropped(
    street: TaughtStreet, processing_s: float, dropped: int, age_s: float
) -> None:
    eye = Blank(street, street.studio(8.0, 1.0, study.CAMERA_S), processing_s)
    arrived = []
    for tick in range(500):
        now = 0.001 * tick
        if tick % 37 == 0 and tick < 8 * 37:
            eye.record_odometry(OdometrySample(now, now, 8.0, 0.0))
            eye.look(now, Pose2D(0.0, 0.0, 0.0), PlantState())
        for scan in eye.scans(now):
            arrived.append(scan.arrival_s - scan.stamp_s)
            eye.localized(0.002)
    assert eye.timing.dropped == dropped
    assert len(arrived) == 8 - dropped
    np.testing.assert_allclose(arrived, READOUT_S + age_s, atol=0.0011)


def test_processing_is_measured_where_it_is_not_stated(street: TaughtStreet) -> None:
    eye = Blank(street, street.studio(8.0, 1.0, study.CAMERA_S), None)
    eye.localized(5.0)
    eye.look(0.0, Pose2D(0.0, 0.0, 0.0), PlantState())
    eye.look(1.0, Pose2D(0.0, 0.0, 0.0), PlantState())
    assert eye.timing.dropped == 1
    assert eye.timing.age_s[0] > 5.0 + READOUT_S
    assert eye.timing.matching_s[0] > 0.0


def test_parked_cars_are_exchanged_and_nothing_else(street: TaughtStreet) -> None:
    world = make_world(short_street(), 3)
    rng = np.random.default_rng(0)
    one, two = _left(world, rng), _left(world, rng)
    kinds = {thing.owner: thing.kind for thing in world.objects}
    assert one != two
    assert {kinds[owner] for owner in one | two} == {"parked_car"}


def test_the_path_is_the_drivers_without_its_jitter() -> None:
    rng = np.random.default_rng(1)
    x = np.arange(0.0, 60.0, 0.2)
    true = 3.0 * np.sin(x / 20.0)
    poses = np.column_stack([x, true + rng.normal(0.0, 0.01, len(x)), 0.15 * np.cos(x / 20.0)])
    # the car stands before it goes
    path, start = _path_of(np.vstack([np.repeat(poses[:1], 40, axis=0), poses]))
    off = [path.locate(a, b, 0.0).lateral_m for a, b in zip(x[60:240], true[60:240], strict=True)]
    assert np.abs(off).max() < 0.02
    assert start.yaw_rad == pytest.approx(0.15 * np.cos(start.x_m / 20.0), abs=0.02)


def test_a_short_street_is_taught_mapped_and_driven(street: TaughtStreet) -> None:
    true = np.array([[pole.x_m, pole.y_m] for pole in street.world.poles()]) + street.origin_m
    assert len(street.course.pole_map) >= 4
    away = np.hypot(*(street.course.pole_map.points_m[:, None] - true).transpose(2, 0, 1))
    assert np.median(away.min(axis=1)) < 0.3
    case = study.Case("few", "", "filter", 7, 0.05)
    driven = study._drive(load_car("passat"), street, 6.0, case, 3.0)
    timing = driven.timing
    assert timing is not None
    assert timing.dropped == 0
    assert len(timing.age_s) >= 8
    # the driver steers for six seconds; the true pose lies on the taught path
    assert np.abs(driven.run.lateral_m).max() < 0.1
    (_, picture, axes), *_ = timing.shown
    assert picture.shape == (480, 768)
    assert axes.shape[1:] == (2, 2)


def test_camera_and_fixes_alone_map_the_street_but_for_its_place(street: TaughtStreet) -> None:
    solved = street.solved
    assert solved is not None
    assert solved.true_path is street.course.path
    assert solved.path.length_m == pytest.approx(street.course.path.length_m, rel=0.02)
    apart = solved.pole_map.points_m[:, None] - street.course.pole_map.points_m
    nearest = np.hypot(*apart.transpose(2, 0, 1)).argmin(axis=1)
    apart = apart[np.arange(len(apart)), nearest]
    # the fixes wander by metres; what counts is that poles and path are off by the same
    assert np.hypot(*(apart - apart.mean(axis=0)).T).max() < 0.8


def test_the_camera_tells_the_motion_where_no_wheels_do(street: TaughtStreet) -> None:
    """The driver follows the true path while the localizer knows nothing but pictures and fixes."""
    case = study.Case("camera", "", "filter", 7, 0.05, solved=True)
    driven = study._drive(load_car("passat"), street, 6.0, case, 3.0)
    assert np.abs(driven.run.lateral_m).max() < 0.1
    eye = CameraEye(street, street.studio(6.0, 1.0, 0.2), 0.05, measures_motion=True)
    start = street.course.start
    for step in range(4):
        ahead = 1.2 * step + 4.0
        x, y = start.x_m + ahead * np.cos(start.yaw_rad), start.y_m + ahead * np.sin(start.yaw_rad)
        eye.look(0.2 * step, Pose2D(x, y, start.yaw_rad), PlantState(vx_mps=6.0))
    assert eye.motion(0.26) == []
    told = eye.motion(1.0)
    assert [sample.stamp_s for sample in told] == pytest.approx([0.1, 0.3, 0.5])
    assert {sample.arrival_s for sample in told} == {1.0}
    assert [sample.speed_mps for sample in told] == pytest.approx([6.0] * 3, rel=0.05)


def test_a_drive_that_was_never_handed_over_has_failed_and_costs_nothing() -> None:
    stamps = np.arange(0.0, 20.0, 0.01)
    error = np.full((len(stamps), 3), np.nan)
    error[600:] = 0.04

    def driven(engaged_s: float) -> study.Driven:
        run = FollowRun(stamps, 0.05 * np.sin(stamps), 0.0 * stamps, engaged_s, 0.0, False, error)
        return study.Driven(run, None)

    drives = {(kmh, case.key): [driven(6.0)] for kmh in study.SPEEDS_KMH for case in study.CASES}
    drives[50, "camera"] = [driven(float("nan"))]
    made = study._study(drives, [70])
    lines = {line.name: line for line in made.lines}
    assert lines["50 km/h, 74 ms, map of camera and GNSS, camera odometry"].claim == "1 failed"
    assert lines["50 km/h: what doing without reference and wheels cost"].ours == "-"
    assert lines["50 km/h: what 74 ms of processing cost"].ours == "+0 mm rms"
    assert made.figures["30_here_pose_lateral_m"] == pytest.approx(0.04)
    assert made.figures["30_here_rms_m"] == pytest.approx(0.05 / np.sqrt(2.0), rel=0.05)


def test_takes_no_estimator() -> None:
    with pytest.raises(ConfigError, match="takes no --estimator"):
        study.full_loop_study(load_car("passat"), 1, lambda _n: None, ("clones",))
