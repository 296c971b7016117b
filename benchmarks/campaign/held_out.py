"""Kinds of fault that no setting was chosen with: written before, run after the filters stood.

`python -m benchmarks.campaign.contradictions --held-out`. They mix what `fault_kinds.py` has
one at a time, or damage a stream in ways that it does not know.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.campaign.drives import Case, blind, street
from benchmarks.campaign.faults import (
    Faulty,
    Kind,
    bend_s,
    fixes_walk,
    mirrored,
    rates,
    scans_changed,
    yaw_rate_changed,
)
from polemap.drivelog.detections import Detections
from polemap.simulate.stream_faults import OdometryDropout
from polemap.vehicle.pose import rotation

Floats = NDArray[np.float64]


def without_fixes(case: Case, from_s: float, until_s: float) -> Case:
    """A case whose receiver is silent for a while."""
    fixes = case.drive.gnss
    assert fixes is not None
    kept = fixes.take((fixes.stamp_s < from_s) | (fixes.stamp_s >= until_s))
    return replace(case, drive=replace(case.drive, gnss=kept))


def slip_without_fixes(seed: int) -> Faulty:
    """Both wheels slip by a fifth for 6 s, and there is no fix for 20 s about that."""
    case = street(seed)
    start = bend_s(case)
    case = rates(case, start, start + 6.0, speed=lambda v: 1.2 * v)
    return Faulty(without_fixes(case, start - 7.0, start + 13.0), start, start + 6.0)


def zeros_now_and_then(seed: int) -> Faulty:
    """The speed is zero for 0.1 s in every second, eight times."""
    case = street(seed)
    for k in range(8):
        case = rates(case, 18.0 + k, 18.1 + k, speed=lambda v: 0.0 * v)
    return Faulty(case, 18.0, 25.1)


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


def yaw_rate_drifts(rate_radps2: float, seconds: float) -> Kind:
    """A gyroscope that warms up: its offset grows steadily and is gone with a restart of it."""

    def kind(seed: int) -> Faulty:
        case, start = street(seed), 16.0
        odometry = case.drive.odometry
        assert odometry is not None
        grown = np.maximum(odometry.stamp_s - start, 0.0) * rate_radps2
        case = rates(case, start, start + seconds, yaw_rate=lambda w: w + grown)
        return Faulty(case, start, start + seconds)

    return kind


def scans_at_another_time(by_s: float, seconds: float) -> Kind:
    """The detector's clock jumps: stamps are off for a while, arrivals are not."""

    def kind(seed: int) -> Faulty:
        case, start = street(seed), 18.0
        scans = tuple(
            replace(s, stamp_s=s.stamp_s + by_s) if start <= s.stamp_s < start + seconds else s
            for s in case.scans
        )
        return Faulty(replace(case, scans=scans), start, start + seconds)

    return kind


def scans_twice(seed: int) -> Faulty:
    """Every scan comes again 20 ms later under a stamp of its own."""
    case = street(seed)
    scans = [
        replace(s, stamp_s=s.stamp_s + late, arrival_s=s.arrival_s + late)
        for s in case.scans
        for late in (0.0, 0.02)
    ]
    return Faulty(replace(case, scans=tuple(scans)))


def map_moved(by_m: float, turn_rad: float = 0.0) -> Kind:
    """The whole map stands aside of the fixes, as a datum that was mistaken leaves it."""

    def kind(seed: int) -> Faulty:
        case = street(seed)
        middle = case.pole_map.points_m.mean(axis=0)
        shift = by_m * np.array([np.cos(2.4 * seed), np.sin(2.4 * seed)])
        points = (case.pole_map.points_m - middle) @ rotation(turn_rad).T + middle + shift
        return Faulty(replace(case, pole_map=replace(case.pole_map, points_m=points)))

    return kind


def turned(by_rad: float) -> Callable[[Detections], Detections]:
    """A detector whose mounting has turned."""
    turn = rotation(by_rad)
    return lambda scan: scan.with_columns(
        points_vehicle_m=scan.points_vehicle_m @ turn.T,
        covariance_m2=turn @ scan.covariance_m2 @ turn.T,
    )


def slip_and_turn(seed: int) -> Faulty:
    """Speed a quarter too high and turn halved for 4 s, as wheels of one axle do that spin."""
    case = street(seed)
    start = bend_s(case)
    case = rates(case, start, start + 4.0, speed=lambda v: 1.25 * v, yaw_rate=lambda w: 0.5 * w)
    return Faulty(case, start, start + 4.0)


def frozen_speed(seed: int) -> Faulty:
    """The speed stays what it was for 4 s while the car goes on as it does."""
    case = street(seed)
    start = bend_s(case)
    odometry = case.drive.odometry
    assert odometry is not None
    last = float(np.interp(start, odometry.stamp_s, odometry.speed_mps))
    return Faulty(
        rates(case, start, start + 4.0, speed=lambda v: 0.0 * v + last), start, start + 4.0
    )


def silence_without_poles(seed: int) -> Faulty:
    """No odometry for 2 s in the midst of 5 s without poles."""
    case = street(seed)
    start = bend_s(case)
    fault = OdometryDropout(from_s=start, until_s=start + 2.0)
    drive = fault.apply(case.drive, np.random.default_rng(seed))
    return Faulty(blind(replace(case, drive=drive), start - 1.5, start + 3.5), start, start + 2.0)


def walking_fixes_without_poles(seed: int) -> Faulty:
    """Fixes that walk off at 0.2 m/s, and no pole for 10 s."""
    faulty = fixes_walk(0.2)(seed)
    return replace(faulty, case=blind(faulty.case, 24.0, 34.0))


HELD_OUT: dict[str, Kind] = {
    "slip x 1.2 for 6 s, no fixes": slip_without_fixes,
    "speed 0 for 0.1 s, eight times": zeros_now_and_then,
    "yaw rate ends at 0.12 rad/s": yaw_rate_changed(lambda w: np.clip(w, -0.12, 0.12)),
    "odometry held back by 0.5 s for 8 s": odometry_held_back(0.5, 8.0),
    "yaw rate drifts by 0.01 rad/s a second, 10 s": yaw_rate_drifts(0.01, 10.0),
    "speed frozen for 4 s": frozen_speed,
    "speed x 1.25 and half the turn for 4 s": slip_and_turn,
    "odometry silent for 2 s, no poles for 5 s": silence_without_poles,
    "fixes walk off at 0.2 m/s, no poles for 10 s": walking_fixes_without_poles,
    "scans stamped 0.3 s early for 8 s": scans_at_another_time(-0.3, 8.0),
    "every scan twice": scans_twice,
    "poles mirrored for 3 s": scans_changed(mirrored, 3.0),
    "detector turned by 2 degrees": scans_changed(turned(np.radians(2.0))),
    "map moved by 1.5 m": map_moved(1.5),
    "map turned by 1 degree": map_moved(0.0, np.radians(1.0)),
}
"""Every kind by its name."""
