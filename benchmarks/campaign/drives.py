"""The drives of the campaign: what a fault is laid over."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.map.pole_map import PoleMap
from polemap.simulate.config import DetectorConfig
from polemap.simulate.points.drive import PointDrive, PointScenario, gnss, simulate_points
from polemap.simulate.points.motion import (
    NO_SLIP,
    RATE_HZ,
    CityTraffic,
    PointMotion,
    Slip,
    driven,
)
from polemap.simulate.sensors import ReferenceErrors

Floats = NDArray[np.float64]

_NOTHING = np.empty(0, dtype=np.int64)

TRUTH = ReferenceErrors(sd_m=0.0, time_s=1.0, yaw_sd_rad=0.0)
STREET = PointScenario(
    duration_s=40.0,
    motion=CityTraffic(slip=Slip()),
    gnss=gnss(2.0),
    detector=DetectorConfig(rate_hz=11.0),
    reference=TRUTH,
)
"""A car in town, poles every 5 m along its way."""


@dataclass(frozen=True, slots=True)
class Case:
    """A drive with its truth as the reference, what its detector saw, and the map to use."""

    drive: Drive
    scans: tuple[Detections, ...]
    pole_map: PoleMap


def street(seed: int, scenario: PointScenario = STREET) -> Case:
    """A street of poles every 5 m, of odd seeds every 10 m."""
    if seed % 2:
        scenario = replace(scenario, pole_spacing_m=10.0)
    return case_of(simulate_points(scenario, np.random.default_rng([seed, 77])))


def case_of(points: PointDrive) -> Case:
    """A drive of points, nothing wrong with it."""
    return Case(points.drive, points.scans, points.pole_map)


@dataclass(frozen=True, slots=True)
class CarPark:
    """2 m/s, straights of 6 to 14 m and turns of 4 to 5 m radius through 90 or 180 degrees."""

    def drawn(self, duration_s: float, rng: np.random.Generator) -> PointMotion:
        """See `MotionModel`."""
        stamps = np.arange(round(duration_s * RATE_HZ) + 1) / RATE_HZ
        speed = np.minimum(stamps, 2.0) * (1.0 + 0.1 * np.sin(0.4 * stamps + rng.uniform(0.0, 6.0)))
        way = np.cumsum(speed) / RATE_HZ
        knots, bends, at = [0.0], [0.0], 0.0
        while at < way[-1]:
            at += rng.uniform(6.0, 14.0)
            bend = rng.choice([-1.0, 1.0]) / rng.uniform(4.0, 5.0)
            end = at + 1.0 + rng.choice([0.5, 1.0]) * np.pi / abs(bend)
            knots += [at, at + 1.0, end - 1.0, end]
            bends += [0.0, bend, bend, 0.0]
            at = end
        return driven(speed, speed * np.interp(way, knots, bends), NO_SLIP, rng)


def car_park(seed: int) -> Case:
    """Tight turns in which the yaw rate from steering is 7 % too small.

    The map is surveyed (0.02 m), the fixes are good (0.5 m). Twice no pole is seen for four
    seconds, each time from the middle of a tight turn on.
    """
    scenario = PointScenario(
        duration_s=90.0, motion=CarPark(), pole_spacing_m=4.0, map_sd_m=0.02,
        gnss=gnss(2.0, 0.5), reference=TRUTH,
        detector=DetectorConfig(rate_hz=11.0, half_view_rad=0.6, range_max_m=25.0),
    )  # fmt: skip
    case = case_of(simulate_points(scenario, np.random.default_rng([seed, 78])))
    odometry, fixes = case.drive.odometry, case.drive.gnss
    assert odometry is not None
    assert fixes is not None
    curvature = np.abs(odometry.yaw_rate_radps) / np.maximum(np.abs(odometry.speed_mps), 0.5)
    tight = np.clip(curvature / 0.25, 0.0, 1.0)
    odometry = replace(odometry, yaw_rate_radps=odometry.yaw_rate_radps * (1.0 - 0.07 * tight))
    fixes = replace(fixes, hdop=np.full(len(fixes), 0.5))
    case = replace(case, drive=replace(case.drive, odometry=odometry, gnss=fixes))
    for after_s in (30.0, 60.0):
        turning = odometry.stamp_s[(tight > 0.9) & (odometry.stamp_s > after_s)]
        begin = float(turning[0]) if len(turning) else after_s
        case = blind(case, begin, begin + 4.0)
    return case


def blind(case: Case, from_s: float, until_s: float) -> Case:
    """Nothing is seen for a while, though the detector looks."""
    scans = tuple(s.take(_NOTHING) if from_s <= s.stamp_s < until_s else s for s in case.scans)
    return replace(case, scans=scans)
