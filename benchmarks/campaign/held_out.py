"""Kinds of fault that no setting was chosen with: written before, run after the filters stood.

`python -m benchmarks.campaign.contradictions --held-out`. They mix what `fault_kinds.py` has
one at a time, or damage a stream in ways that it does not know.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.campaign.detector_faults import (
    Faulty,
    Kind,
    mirrored,
    ranges_times,
    scans_at_another_time,
    scans_changed,
    turned,
)
from benchmarks.campaign.drives import Case, blind, street
from benchmarks.campaign.faults import bend_s, fixes_jump, fixes_walk, rates, yaw_rate_changed
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


def ranges_short(by_m: float) -> Kind:
    """Every pole is nearer by the same length: the mounting's x, or a lens that has moved."""

    def nearer(scan: Detections) -> Detections:
        ranges = np.maximum(np.hypot(*scan.points_vehicle_m.T), 2.0 * by_m)
        return scan.with_columns(
            points_vehicle_m=scan.points_vehicle_m * (1.0 - by_m / ranges)[:, None]
        )

    return scans_changed(nearer)


def one_side(seed: int) -> Faulty:
    """Only poles on the left are seen for 15 s: a wall of parked lorries."""

    def left(scan: Detections) -> Detections:
        return scan.take(scan.points_vehicle_m[:, 1] > 0.0)

    return scans_changed(left, 15.0)(seed)


def clutter_and_slip(seed: int) -> Faulty:
    """Every scan has as much clutter as poles for 12 s, and in its midst the wheels slip."""
    case, rng = street(seed), np.random.default_rng([seed, 6])
    start = bend_s(case)

    def cluttered(scan: Detections) -> Detections:
        twice = scan.take(np.tile(np.arange(len(scan)), 2))
        ranges, bearings = rng.uniform(5.0, 30.0, len(scan)), rng.uniform(-0.44, 0.44, len(scan))
        places = np.stack([ranges * np.cos(bearings), ranges * np.sin(bearings)], axis=1)
        return twice.with_columns(points_vehicle_m=np.vstack([scan.points_vehicle_m, places]))

    scans = tuple(
        cluttered(s) if start - 5.0 <= s.stamp_s < start + 7.0 and len(s) else s for s in case.scans
    )
    case = rates(replace(case, scans=scans), start, start + 3.0, speed=lambda v: 1.3 * v)
    return Faulty(case, start - 5.0, start + 7.0)


def odometry_lag_grows(to_s: float, over_s: float) -> Kind:
    """A queue that fills: odometry tells what was ever longer ago, then it is emptied at once."""

    def kind(seed: int) -> Faulty:
        case, start = street(seed), 16.0
        odometry = case.drive.odometry
        assert odometry is not None
        stamps = odometry.stamp_s
        inside = (stamps >= start) & (stamps < start + over_s)
        then = np.where(inside, stamps - to_s * (stamps - start) / over_s, stamps)
        changed = replace(
            odometry,
            speed_mps=np.interp(then, stamps, odometry.speed_mps),
            yaw_rate_radps=np.interp(then, stamps, odometry.yaw_rate_radps),
        )
        drive = replace(case.drive, odometry=changed)
        return Faulty(replace(case, drive=drive), start, start + over_s)

    return kind


def wrong_direction(seed: int) -> Faulty:
    """The speed has the sign of reverse gear for 2 s."""
    case = street(seed)
    start = bend_s(case)
    return Faulty(rates(case, start, start + 2.0, speed=lambda v: -v), start, start + 2.0)


def map_stretched(by: float) -> Kind:
    """The map's scale is wrong, as of a grid whose point scale was forgotten."""

    def kind(seed: int) -> Faulty:
        case = street(seed)
        points = case.pole_map.points_m
        stretched = points.mean(axis=0) + (1.0 + by) * (points - points.mean(axis=0))
        return Faulty(replace(case, pole_map=replace(case.pole_map, points_m=stretched)))

    return kind


def fixes_jump_without_poles(seed: int) -> Faulty:
    """The fixes jump by 20 m while no pole is seen for 8 s, and stay there."""
    faulty = fixes_jump(20.0)(seed)
    return replace(faulty, case=blind(faulty.case, 16.0, 24.0))


def turns_slowly(to_rad: float, over_s: float) -> Kind:
    """A mounting that works loose: the detector turns ever further."""

    def kind(seed: int) -> Faulty:
        case, start = street(seed), 10.0
        scans = tuple(
            turned(to_rad * min(1.0, (s.stamp_s - start) / over_s))(s)
            if s.stamp_s >= start and len(s)
            else s
            for s in case.scans
        )
        return Faulty(replace(case, scans=scans), start)

    return kind


def turned_and_short(scan: Detections) -> Detections:
    """A little turned, and ranges a little short."""
    return ranges_times(0.95)(turned(np.radians(1.0))(scan))


HELD_OUT: dict[str, Kind] = {
    "slip x 1.2 for 6 s, no fixes": slip_without_fixes,
    "speed 0 for 0.1 s, eight times": zeros_now_and_then,
    "yaw rate ends at 0.12 rad/s": yaw_rate_changed(lambda w: np.clip(w, -0.12, 0.12)),
    "yaw rate drifts by 0.01 rad/s a second, 10 s": yaw_rate_drifts(0.01, 10.0),
    "speed frozen for 4 s": frozen_speed,
    "speed x 1.25 and half the turn for 4 s": slip_and_turn,
    "odometry silent for 2 s, no poles for 5 s": silence_without_poles,
    "fixes walk off at 0.2 m/s, no poles for 10 s": walking_fixes_without_poles,
    "every scan twice": scans_twice,
    "poles mirrored for 3 s": scans_changed(mirrored, 3.0),
    "map moved by 1.5 m": map_moved(1.5),
    "map turned by 1 degree": map_moved(0.0, np.radians(1.0)),
    "detector ranges 0.4 m short": ranges_short(0.4),
    "detector ranges x 0.95, turned by 1 degree": scans_changed(turned_and_short),
    "detector turns to 3 degrees over 20 s": turns_slowly(np.radians(3.0), 20.0),
    "scans stamped 0.3 s late for 8 s": scans_at_another_time(0.3, 8.0),
    "poles of the left side only for 15 s": one_side,
    "clutter doubled for 12 s, slip x 1.3 for 3 s": clutter_and_slip,
    "odometry's lag grows to 0.4 s over 12 s": odometry_lag_grows(0.4, 12.0),
    "speed of the other sign for 2 s": wrong_direction,
    "fixes jump 20 m, no poles for 8 s": fixes_jump_without_poles,
    "map stretched by 1 %": map_stretched(0.01),
}
"""Every kind by its name."""
