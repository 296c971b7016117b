"""The kinds of fault of the campaign, each a change of a case that a seed makes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.campaign.car_parks import Layout, hard_car_park
from benchmarks.campaign.detector_faults import Faulty, Kind
from benchmarks.campaign.drives import Case, blind, street
from polemap.map.pole_map import PoleMap
from polemap.simulate.map_faults import with_extra_poles, without_poles
from polemap.simulate.stream_faults import GnssOffset, OdometryDropout
from polemap.vehicle.pose import rotation

Floats = NDArray[np.float64]
Rows = NDArray[np.bool_]


def bend_s(case: Case, first_s: float = 14.0, last_s: float = 26.0) -> float:
    """Where between two moments the drive turns most."""
    odometry = case.drive.odometry
    assert odometry is not None
    inside = (odometry.stamp_s >= first_s) & (odometry.stamp_s <= last_s)
    turning = np.where(inside, np.abs(odometry.yaw_rate_radps), -1.0)
    return float(odometry.stamp_s[np.argmax(turning)])


def rates(
    case: Case,
    from_s: float,
    until_s: float,
    speed: Callable[[Floats], Floats] | None = None,
    yaw_rate: Callable[[Floats], Floats] | None = None,
) -> Case:
    """Speed or yaw rate of the odometry changed for a while."""
    odometry = case.drive.odometry
    assert odometry is not None
    hit = (odometry.stamp_s >= from_s) & (odometry.stamp_s < until_s)
    changed = odometry
    if speed is not None:
        values = np.where(hit, speed(odometry.speed_mps), odometry.speed_mps)
        changed = replace(changed, speed_mps=values)
    if yaw_rate is not None:
        values = np.where(hit, yaw_rate(odometry.yaw_rate_radps), odometry.yaw_rate_radps)
        changed = replace(changed, yaw_rate_radps=values)
    return replace(case, drive=replace(case.drive, odometry=changed))


def speed_times(factor: float, seconds: float, *, unseen: bool = False) -> Kind:
    """Wheels that slip, spin or lock: the speed times a factor, in a bend."""

    def kind(seed: int) -> Faulty:
        case = street(seed)
        start = bend_s(case)
        case = rates(case, start, start + seconds, speed=lambda v: factor * v)
        if unseen:
            case = blind(case, start - 0.5, start + seconds + 1.0)
        return Faulty(case, start, start + seconds)

    return kind


def speed_drifts(factor: float, over_s: float, seconds: float) -> Kind:
    """The speed goes wrong gently, as no single sample shows."""

    def kind(seed: int) -> Faulty:
        case = street(seed)
        start = bend_s(case)
        odometry = case.drive.odometry
        assert odometry is not None
        share = np.clip((odometry.stamp_s - start) / over_s, 0.0, 1.0)
        wrong = rates(case, start, start + seconds, speed=lambda v: v * (1 + (factor - 1) * share))
        return Faulty(wrong, start, start + seconds)

    return kind


def yaw_rate_changed(change: Callable[[Floats], Floats], seconds: float = np.inf) -> Kind:
    """The yaw rate with another sign, scale or offset."""

    def kind(seed: int) -> Faulty:
        case = street(seed)
        start = bend_s(case) if np.isfinite(seconds) else 0.0
        return Faulty(rates(case, start, start + seconds, yaw_rate=change), start, start + seconds)

    return kind


def silent(seconds: float) -> Kind:
    """No odometry for a while, in a bend."""

    def kind(seed: int) -> Faulty:
        case = street(seed)
        start = bend_s(case)
        fault = OdometryDropout(from_s=start, until_s=start + seconds)
        drive = fault.apply(case.drive, np.random.default_rng(seed))
        return Faulty(replace(case, drive=drive), start, start + seconds)

    return kind


def odometry_held_back(by_s: float, seconds: float) -> Kind:
    """Odometry tells what was `by_s` ago, under stamps that look right."""

    def kind(seed: int) -> Faulty:
        case, start = street(seed), 18.0
        odometry = case.drive.odometry
        assert odometry is not None
        stamps = odometry.stamp_s
        late = (stamps >= start) & (stamps < start + seconds)
        then = np.where(late, stamps - by_s, stamps)
        changed = replace(
            odometry,
            speed_mps=np.interp(then, stamps, odometry.speed_mps),
            yaw_rate_radps=np.interp(then, stamps, odometry.yaw_rate_radps),
        )
        drive = replace(case.drive, odometry=changed)
        return Faulty(replace(case, drive=drive), start, start + seconds)

    return kind


def unseen(seconds: float) -> Kind:
    """No pole is seen for a while, though the detector looks."""

    def kind(seed: int) -> Faulty:
        return Faulty(blind(street(seed), 15.0, 15.0 + seconds), 15.0, 15.0 + seconds)

    return kind


def fixes_late(by_s: float) -> Kind:
    """Every fix says where the car was `by_s` seconds before its stamp."""

    def kind(seed: int) -> Faulty:
        case = street(seed)
        gnss = case.drive.gnss
        assert gnss is not None
        late = replace(gnss, stamp_s=gnss.stamp_s + by_s, arrival_s=gnss.arrival_s + by_s)
        return Faulty(replace(case, drive=replace(case.drive, gnss=late)))

    return kind


def fixes_jump(by_m: float, seconds: float = np.inf, start_s: float = 18.0) -> Kind:
    """All fixes shifted from one moment on, in a direction of the seed's choice."""

    def kind(seed: int) -> Faulty:
        case, turn = street(seed), 2.4 * seed
        fault = GnssOffset(
            from_s=start_s, until_s=start_s + seconds,
            east_m=by_m * np.cos(turn), north_m=by_m * np.sin(turn),
        )  # fmt: skip
        drive = fault.apply(case.drive, np.random.default_rng(seed))
        return Faulty(replace(case, drive=drive), start_s, start_s + seconds)

    return kind


def fixes_walk(rate_mps: float) -> Kind:
    """Fixes that wander off slowly, as spoofed ones do."""

    def kind(seed: int) -> Faulty:
        case = street(seed)
        gnss = case.drive.gnss
        assert gnss is not None
        off = rate_mps * np.maximum(gnss.stamp_s - 15.0, 0.0)
        return Faulty(
            replace(case, drive=replace(case.drive, gnss=replace(gnss, east_m=gnss.east_m + off))),
            15.0,
        )

    return kind


def aged_map(gone: float, extra: float) -> Kind:
    """A share of the street's poles is not in the map, and the map has others that are gone."""

    def kind(seed: int) -> Faulty:
        case, rng = street(seed), np.random.default_rng([seed, 5])
        aged = with_extra_poles(without_poles(case.pole_map, gone, rng), extra, rng)
        return Faulty(replace(case, pole_map=aged))

    return kind


def doubled_map(shift_m: float, turn_rad: float = 0.0) -> Kind:
    """Every pole twice: two surveys that were never brought together."""

    def kind(seed: int) -> Faulty:
        case = street(seed)
        return Faulty(replace(case, pole_map=twice(case.pole_map, shift_m, 2.4 * seed, turn_rad)))

    return kind


def twice(pole_map: PoleMap, shift_m: float, towards_rad: float, turn_rad: float) -> PoleMap:
    """The map and its copy, shifted and turned about the middle."""
    middle = pole_map.points_m.mean(axis=0)
    copy = (pole_map.points_m - middle) @ rotation(turn_rad).T + middle
    copy = copy + shift_m * np.array([np.cos(towards_rad), np.sin(towards_rad)])
    rows = np.tile(np.arange(len(pole_map)), 2)
    names = ("covariance_m2", "width_m", "height_m", "observations", "drives", "existence")
    return replace(
        pole_map,
        ids=np.arange(len(rows)),
        points_m=np.vstack([pole_map.points_m, copy]),
        **{name: getattr(pole_map, name)[rows] for name in names},
    )


def other_map(seed: int) -> Faulty:
    """The map of another street, moved to this one."""
    case, other = street(seed), street(seed + 1000)
    shift = case.pole_map.points_m.mean(axis=0) - other.pole_map.points_m.mean(axis=0)
    moved = replace(other.pole_map, points_m=other.pole_map.points_m + shift)
    return Faulty(replace(case, pole_map=moved))


def parked(layout: Layout) -> Kind:
    """Nothing is wrong with the sensors that is not always so in a car park."""
    return lambda seed: Faulty(hard_car_park(seed, layout), 20.0)
