"""Driver and dynamics: stops, limits, wander, laps; the car against its closed form."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.drivelog.errors import ConfigError
from polemap.simulate.driver import STEP_S, drive_route
from polemap.simulate.dynamics import CAR, follow
from polemap.simulate.route import make_route
from polemap.simulate.scenario import DriveSpec, Scenario, UTurnSpec


def route_of(street: Scenario):  # type: ignore[no-untyped-def]
    return make_route(street.route.corners_m, street.route.corner_radius_m, street.route.closed)


def test_every_lap_opens_with_a_standstill(street: Scenario) -> None:
    motion = drive_route(route_of(street), street.drive, 3, np.random.default_rng(1))
    assert len(motion.lap_starts_s) == 4
    for start in motion.lap_starts_s[:-1]:
        pause = (motion.stamp_s > start + 0.7) & (motion.stamp_s < start + 1.5)
        assert motion.speed_mps[pause].max() == 0.0
        assert np.abs(motion.yaw_rate_radps[pause]).max() < 1e-6
    assert np.diff(motion.lap_starts_s) == pytest.approx(
        np.full(3, np.diff(motion.lap_starts_s)[0]), rel=0.1
    )


def test_speed_and_lateral_acceleration_stay_within_limits(street: Scenario) -> None:
    spec = street.drive
    motion = drive_route(route_of(street), spec, 2, np.random.default_rng(2))
    assert motion.speed_mps.max() < 1.35 * spec.speed_mps
    sideways = np.abs(motion.speed_mps * motion.yaw_rate_radps)
    assert sideways.max() < 1.5 * spec.lateral_acceleration_mps2
    assert motion.speed_mps.min() >= 0.0


def test_motion_is_consistent(street: Scenario) -> None:
    motion = drive_route(route_of(street), street.drive, 1, np.random.default_rng(4))
    step = np.diff(motion.pose, axis=0) / STEP_S
    yaw = motion.pose[:-1, 2]
    forward = np.cos(yaw) * step[:, 0] + np.sin(yaw) * step[:, 1]
    assert np.allclose(forward, motion.speed_mps[:-1], atol=1e-6)
    assert np.allclose(step[:, 2], motion.yaw_rate_radps[:-1], atol=0.02)


def test_drivers_wander_as_much_as_the_scenario_says(street: Scenario) -> None:
    long = make_route([(0, 0), (400, 0), (400, 60), (0, 60)], 20.0, True)
    spread = {}
    for sd in (0.0, 0.2):
        spec = DriveSpec(wander_sd_m=(sd, sd))
        motion = drive_route(long, spec, 3, np.random.default_rng(7))
        straight = np.abs(long.curvature_at(motion.station_m)) < 1e-3
        spread[sd] = float(motion.wander_m[straight].std())
    assert spread[0.0] < 0.06
    assert spread[0.2] == pytest.approx(0.2, rel=0.4)


def test_laps_differ_and_seeds_decide(street: Scenario) -> None:
    runs = [
        drive_route(route_of(street), street.drive, 2, np.random.default_rng(seed))
        for seed in (1, 1, 2)
    ]
    assert np.array_equal(runs[0].pose, runs[1].pose)
    count = min(len(runs[0].pose), len(runs[2].pose))
    assert not np.array_equal(runs[0].pose[:count], runs[2].pose[:count])


def test_evasions_go_to_the_left_and_back(street: Scenario) -> None:
    long = make_route([(0, 0), (300, 0), (300, 60), (0, 60)], 20.0, True)
    spec = DriveSpec(evasions=3.0, wander_sd_m=(0.0, 0.0))
    motion = drive_route(long, spec, 2, np.random.default_rng(3))
    assert motion.wander_m.max() > 0.8
    assert motion.wander_m.min() > -0.5


def test_an_open_route_has_one_lap(street: Scenario) -> None:
    route = make_route([(0, 0), (60, 0), (60, 50)], 10.0, False)
    with pytest.raises(ConfigError, match=r"--laps 2: the route of this world is open"):
        drive_route(route, DriveSpec(), 2, np.random.default_rng(0))
    assert drive_route(route, DriveSpec(), 1, np.random.default_rng(0)).stamp_s[-1] > 10


@pytest.mark.parametrize("speed", [6.0, 15.0])
def test_a_steady_circle_has_the_side_slip_of_the_single_track_model(speed: float) -> None:
    """beta = b/R - m a v^2 / (C_r L R), Rajamani (3.21), with a, b the axle distances."""
    car, radius = CAR, 60.0
    angle = np.arange(0, 2 * np.pi, 0.25 / radius)
    line = radius * np.stack([np.sin(angle), 1 - np.cos(angle)], axis=1)
    time = np.arange(0, 0.8 * len(line) * 0.25 / speed, STEP_S)
    ride = follow(line, 0.25, speed * time, STEP_S, car)
    tail = slice(len(time) // 2, len(time) - 200)
    assert ride.yaw_rate_radps[tail].mean() == pytest.approx(speed / radius, rel=0.01)
    rear_slip = car.mass_kg * car.cg_to_front_m * speed**2 / (
        2 * car.rear_stiffness_nprad * car.wheelbase_m * radius
    )  # fmt: skip
    expected = car.cg_to_rear_m / radius - rear_slip
    assert ride.sideslip_rad[tail].mean() == pytest.approx(expected, abs=3e-4)
    distance = np.hypot(ride.pose[tail, 0], ride.pose[tail, 1] - radius)
    assert np.abs(distance - radius).max() < 0.25


def test_a_u_turn_leads_back_in_the_other_lane_and_on(street: Scenario) -> None:
    long = make_route([(0, 0), (300, 0), (300, 60), (0, 60)], 20.0, True)
    turn = UTurnSpec(at_m=110.0, back_to_m=45.0, radius_m=4.8)
    quiet = DriveSpec(wander_sd_m=(0.0, 0.0), speed_mps=9.0)
    spec = quiet.model_copy(update={"u_turns": [turn]})
    motion = drive_route(long, spec, 2, np.random.default_rng(3))
    plain = drive_route(long, quiet, 2, np.random.default_rng(3))
    street_yaw = long.at(motion.station_m)[:, 2]
    back = np.cos(motion.pose[:, 2] - street_yaw) < -0.9
    # twice 65 m, and the last of each turn
    assert motion.speed_mps[back].sum() * STEP_S == pytest.approx(130, abs=25)
    lane = back & (np.abs(np.mod(motion.station_m, long.length_m) - 77) < 12)
    assert np.median(motion.lateral_m[lane]) == pytest.approx(-spec.lane_offset_m, abs=0.1)
    assert np.abs(motion.wander_m).max() < 0.6
    assert np.abs(motion.steering_rad).max() < 0.6
    extra = 2 * 2 * (65 + np.pi * 4.8)
    way = [m.speed_mps.sum() * STEP_S for m in (motion, plain)]
    assert way[0] - way[1] == pytest.approx(extra, rel=0.05)
    end = long.length_m * 2
    assert motion.station_m[-1] == pytest.approx(end, abs=1.0)
    assert len(motion.lap_starts_s) == 3
    there = np.interp(motion.lap_starts_s, motion.stamp_s, motion.station_m)
    assert there == pytest.approx([0, long.length_m, end], abs=1.0)


def test_u_turns_need_room(street: Scenario) -> None:
    route = route_of(street)
    spec = DriveSpec(u_turns=[UTurnSpec(at_m=95.0, back_to_m=50.0)])
    with pytest.raises(ConfigError, match=r"the turn at 95 m back to 50 m leaves the street"):
        drive_route(route, spec, 1, np.random.default_rng(0))
    with pytest.raises(ValueError, match="lead back by 40 m at least"):
        UTurnSpec(at_m=60.0, back_to_m=30.0)
    fields = street.model_dump()
    fields["drive"]["u_turns"] = [{"at_m": 80.0, "back_to_m": 20.0}]
    with pytest.raises(ValueError, match=r"kerbs leave 2\.2 m"):
        Scenario.model_validate(fields)
