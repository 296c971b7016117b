"""Lines through the particle filter: lanes, ridges, painted roads, what counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.drivelog.detections import Detections, pole_detections
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.line_detections import LineDetections, line_detections
from polemap.drivelog.samples import OdometrySample
from polemap.localize.config import LocalizeConfig
from polemap.localize.particle_filter.estimate import PfEstimate
from polemap.localize.particle_filter.filter import ParticleFilter
from polemap.localize.usable import usable_poles
from polemap.map.line_map import LineMap
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import wrap_angle
from tests.localize.particle_filter.test_line_model import MARKING, ORIGIN_M, line_map

SPEED_MPS = 10.0


def lanes(lefts: tuple[float, ...]) -> LineMap:
    """Straight markings to the east, 400 m long."""
    return line_map([np.array([[-50.0, y], [350.0, y]]) for y in lefts], [MARKING] * len(lefts))


def seen(lefts: tuple[float, ...], rng: np.random.Generator, sd_m: float = 0.05) -> LineDetections:
    y = np.array(lefts) + sd_m * rng.standard_normal(len(lefts))
    start, end = (np.column_stack([np.full(len(y), x), y]) for x in (5.0, 12.0))
    return line_detections(MARKING, start, end, np.full(len(y), 0.07), np.full(len(y), 0.01))


def scan_at(stamp_s: float, lines: LineDetections | None) -> Detections:
    empty = pole_detections(stamp_s, stamp_s, np.empty((0, 2)), np.empty((0, 2, 2)))
    return replace(empty, lines=lines)


def drive(
    street: LineMap,
    by_time: dict[float, tuple[float, ...]],
    *,
    sd_m: tuple[float, float, float] = (0.1, 0.1, 0.005),
    duration_s: float = 20.0,
    settings: dict[str, object] | None = None,
    start_m: tuple[float, float] = (0.0, 0.0),
) -> list[PfEstimate]:
    """East at 10 m/s on the axis; from each time on lines are seen so far left of the car."""
    rng = np.random.default_rng(1)
    pole_map = replace(PoleMap.empty(street.frame), lines=street)
    config = LocalizeConfig(**{"particles": 400, **(settings or {})})
    pf = ParticleFilter(pole_map, config, 2.7, np.random.default_rng(2))
    pf.add_odometry(OdometrySample(0.0, 0.0, SPEED_MPS, 0.0))
    pf.set_pose(0.0, np.array([*(ORIGIN_M + np.array(start_m)), 0.0]), np.diag(np.square(sd_m)))
    estimates = []
    for k in range(1, round(10 * duration_s)):
        stamp = k / 10.0
        pf.add_odometry(OdometrySample(stamp, stamp, SPEED_MPS, 0.0))
        lefts = by_time[max(t for t in by_time if t <= stamp)]
        lines = seen(lefts, rng) if lefts else LineDetections.none()
        estimate = pf.process_scan(scan_at(stamp, lines))
        assert estimate is not None
        estimates.append(estimate)
    return estimates


def aside(estimates: list[PfEstimate]) -> np.ndarray:
    return np.array([e.pose[1] for e in estimates]) - ORIGIN_M[1]


def test_lines_hold_the_car_aside_and_along_it_gets_less_sure() -> None:
    street = lanes((-1.75, 1.75, 5.25))
    estimates = drive(street, {0.0: (-1.75, 1.75, 5.25)})
    without = drive(street, {0.0: (-1.75, 1.75, 5.25)}, settings={"kinds": ("pole",)})
    assert np.abs(aside(estimates[50:])).max() < 0.1
    sd = np.sqrt([np.diag(e.covariance) for e in estimates])
    assert sd[-1, 1] < 0.15
    assert sd[-1, 0] > sd[50, 0] > sd[10, 0]
    assert sd[-1, 0] > 0.8 * np.sqrt(without[-1].covariance[0, 0])
    assert np.sqrt(without[-1].covariance[1, 1]) > 3.0 * sd[-1, 1]
    health = estimates[-1].health.lines
    assert health is not None
    assert health.matched == health.seen == 3
    assert without[-1].health.lines is None


@pytest.mark.parametrize("start_m", [0.0, 3.5])
def test_two_lanes_that_look_alike_are_both_kept(start_m: float) -> None:
    """Four lines, two seen: the lane cannot be told, wherever the better guess was."""
    street = lanes((-1.75, 1.75, 5.25))
    estimates = drive(
        street, {0.0: (-1.75, 1.75)}, sd_m=(0.5, 2.5, 0.01), start_m=(0.0, 0.5 * start_m)
    )
    late = estimates[30:]
    assert not any(e.healthy for e in late)
    assert all(e.modes >= 2 for e in late)


def test_lines_on_both_sides_tell_the_lane_after_a_long_gap() -> None:
    street = lanes((-1.75, 1.75, 5.25))
    estimates = drive(
        street, {0.0: (), 8.0: (-1.75, 1.75, 5.25)}, sd_m=(0.5, 1.5, 0.01), duration_s=25.0
    )
    gap = [e for e in estimates if 2.0 < e.stamp_s < 8.0]
    assert not any(e.healthy for e in gap)
    assert np.abs(aside(estimates[-50:])).max() < 0.15


@pytest.mark.parametrize("moved_m", [0.5, 1.0, 3.0])
def test_a_road_that_was_painted_anew_does_not_drag_the_pose(moved_m: float) -> None:
    street = lanes((-1.75, 1.75, 5.25))
    old = (-1.75, 1.75, 5.25)
    new = tuple(y + moved_m for y in old)
    estimates = drive(street, {0.0: old, 8.0: new}, duration_s=16.0)
    assert all(e.usable for e in estimates if 1.0 < e.stamp_s < 8.0)
    during = [e for e in estimates if e.stamp_s > 8.0]
    assert any(e.health.lines.suspended == ("lane_marking",) for e in during if e.health.lines)
    believed = [e for e in during if e.usable]
    assert len(believed) > 5
    sd = np.sqrt([e.covariance[1, 1] for e in believed])
    assert (np.abs(aside(believed)) < 3.0 * sd).all()


def test_lines_come_back_where_they_fit_again() -> None:
    street = lanes((-1.75, 1.75, 5.25))
    old, new = (-1.75, 1.75, 5.25), (-1.25, 2.25, 5.75)
    estimates = drive(street, {0.0: old, 6.0: new, 7.0: old}, duration_s=16.0)
    kinds = [e.health.lines.suspended for e in estimates if e.health.lines is not None]
    assert ("lane_marking",) in kinds
    assert kinds[-1] == ()
    assert np.abs(aside(estimates[-20:])).max() < 0.15


def test_a_ridge_along_the_street_is_one_place() -> None:
    street = lanes((-1.75, 1.75, 5.25))
    estimates = drive(street, {0.0: (-1.75, 1.75, 5.25)}, sd_m=(3.0, 0.2, 0.005), duration_s=12.0)
    late = estimates[40:]
    assert np.mean([e.modes == 1 for e in late]) > 0.95
    assert min(np.sqrt(e.covariance[0, 0]) for e in late) > 2.0
    assert np.abs(wrap_angle(np.array([e.pose[2] for e in late]))).max() < 0.02


def test_kinds_that_are_not_chosen_say_nothing() -> None:
    street = lanes((-1.75, 1.75))
    settings = {"kinds": ("pole", "kerb"), "particles": 100}
    chosen = drive(street, {0.0: (-1.75, 1.75)}, settings=settings, duration_s=3.0)
    none = drive(street, {0.0: ()}, settings={"particles": 100}, duration_s=3.0)
    assert [e.pose.tolist() for e in chosen] == [e.pose.tolist() for e in none]
    with pytest.raises(ValueError, match="kinds"):
        LocalizeConfig(kinds=("lamp",))
    assert LocalizeConfig(kinds=("pole",)).chosen_kinds == {LandmarkKind.POLE}


def test_pieces_that_no_detector_can_mean_are_left_out() -> None:
    good = seen((1.75, -1.75), np.random.default_rng(0))
    bad = good.with_columns(offset_sd_m=np.array([0.07, np.nan]))
    assert usable_poles(scan_at(0.0, good)).lines is good
    kept = usable_poles(scan_at(0.0, bad)).lines
    assert kept is not None
    assert len(kept) == 1
    short = good.with_columns(end_vehicle_m=good.start_vehicle_m)
    kept = usable_poles(scan_at(0.0, short)).lines
    assert kept is not None
    assert len(kept) == 0
