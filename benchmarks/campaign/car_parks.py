"""Car parks: slow, tight, stop and go, backward, where poles repeat themselves.

What a car park has and a street has not: turns of 4 m radius in which a yaw rate from steering is
wrong by some per cent of itself, more the tighter they are, and differently in each; stops; ways
back; lamps in a grid, so that a wrong place looks like the right one; seconds in which parked cars
hide all poles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.campaign.drives import TRUTH, Case, blind, case_of
from polemap.simulate.config import DetectorConfig
from polemap.simulate.points.drive import PointScenario, gnss, simulate_points
from polemap.simulate.points.motion import NO_SLIP, RATE_HZ, PointMotion, driven
from polemap.simulate.points.poles import Poles

Floats = NDArray[np.float64]
Layout = Literal["along the way", "grid", "rows"]
LAYOUTS: tuple[Layout, ...] = ("along the way", "grid", "rows")

_TIGHT_RADPM = 0.25


@dataclass(frozen=True, slots=True)
class Manoeuvres:
    """2 m/s, turns of 4 to 6 m radius, stops of up to 5 s, and ways back of 4 to 8 m."""

    def drawn(self, duration_s: float, rng: np.random.Generator) -> PointMotion:
        """See `MotionModel`."""
        count = round(duration_s * RATE_HZ) + 1
        speed, bend = np.zeros(count), np.zeros(count)
        row, v = round(2.0 * RATE_HZ), 0.0
        sign = 1.0
        while row < count:
            way, curvature = rng.uniform(4.0, 12.0), 0.0
            if rng.random() < 0.6:
                curvature = rng.choice([-1.0, 1.0]) / rng.uniform(4.0, 6.0)
                way = rng.uniform(0.5, 3.1) / abs(curvature)
            backward = rng.random() < 0.2
            if backward != (sign < 0.0):
                # a change of direction takes a stop
                row, v = self._stop(speed, row, v, sign, rng.uniform(0.5, 1.5))
                sign = -1.0 if backward else 1.0
            way = rng.uniform(4.0, 8.0) if backward else way
            start = row
            cruise = rng.uniform(1.5, 2.5) * (0.6 if backward else 1.0)
            gone = 0.0
            while gone < way and row < count:
                v += np.clip(cruise - v, -1.0 / RATE_HZ, 1.0 / RATE_HZ)
                speed[row], gone, row = sign * v, gone + v / RATE_HZ, row + 1
            # steering takes a metre
            share = np.linspace(0.0, 1.0, row - start)
            ramp = np.clip(way * np.minimum(share, 1.0 - share), 0.0, 1.0)
            bend[start:row] = curvature * ramp
            if rng.random() < 0.25:
                row, v = self._stop(speed, row, v, sign, rng.uniform(0.5, 5.0))
        return driven(speed, speed * bend, NO_SLIP, rng)

    @staticmethod
    def _stop(speed: Floats, row: int, v: float, sign: float, wait_s: float) -> tuple[int, float]:
        while v > 0.0 and row < len(speed):
            v = max(0.0, v - 1.2 / RATE_HZ)
            speed[row], row = sign * v, row + 1
        return row + round(wait_s * RATE_HZ), 0.0


def _lamps(motion: PointMotion, layout: Layout, rng: np.random.Generator) -> Poles | None:
    """Poles in a grid of 8 m, or in rows 15 m apart with one every 5 m; all alike."""
    if layout == "along the way":
        return None
    step = (8.0, 8.0) if layout == "grid" else (5.0, 15.0)
    low, high = motion.states[:, :2].min(axis=0) - 20.0, motion.states[:, :2].max(axis=0) + 20.0
    east, north = (np.arange(a, b, s) for a, b, s in zip(low, high, step, strict=True))
    points = np.stack(np.meshgrid(east, north), axis=-1).reshape(-1, 2)
    points = points + rng.normal(0.0, 0.05, points.shape)
    clear = np.array([
        np.hypot(*(motion.states[::50, :2] - point).T).min() > 1.2 for point in points
    ])  # fmt: skip
    points = points[clear]
    return Poles(points, np.full(len(points), 0.12), np.ones(len(points)))


def hard_car_park(seed: int, layout: Layout) -> Case:
    """Yaw rates wrong by some per cent that differ from turn to turn, and four blind spells."""
    rng = np.random.default_rng([seed, 80, LAYOUTS.index(layout)])
    motion = Manoeuvres().drawn(100.0, rng)

    @dataclass(frozen=True, slots=True)
    class Given:
        def drawn(self, duration_s: float, rng: np.random.Generator) -> PointMotion:
            return motion

    scenario = PointScenario(
        duration_s=100.0, motion=Given(), pole_spacing_m=4.0, map_sd_m=0.02,
        gnss=gnss(2.0, 0.5), reference=TRUTH,
        detector=DetectorConfig(rate_hz=11.0, half_view_rad=0.6, range_max_m=20.0),
    )  # fmt: skip
    case = case_of(simulate_points(scenario, rng, _lamps(motion, layout, rng)))
    odometry, fixes = case.drive.odometry, case.drive.gnss
    assert odometry is not None
    assert fixes is not None
    speed = np.maximum(np.abs(odometry.speed_mps), 0.5)
    tight = np.clip(np.abs(odometry.yaw_rate_radps) / speed / _TIGHT_RADPM, 0.0, 1.0)
    # an error for each turn, 7 % too small in the mean
    turn = np.cumsum(np.diff((tight > 0.3).astype(int), prepend=0) == 1)
    share = rng.normal(-0.07, 0.05, turn.max() + 1)[turn] * tight**2
    odometry = replace(odometry, yaw_rate_radps=odometry.yaw_rate_radps * (1.0 + share))
    fixes = replace(fixes, hdop=np.full(len(fixes), 0.5))
    case = replace(case, drive=replace(case.drive, odometry=odometry, gnss=fixes))
    for after_s in (25.0, 45.0, 65.0, 82.0):
        turning = odometry.stamp_s[(tight > 0.7) & (odometry.stamp_s > after_s)]
        begin = float(turning[0]) if len(turning) else after_s
        case = blind(case, begin, begin + 4.0)
    return case
