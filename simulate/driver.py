"""The driver: which line is driven how fast, with stops, wander and evasions, lap after lap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.simulate.dynamics import CAR, follow
from polemap.simulate.route import Route
from polemap.simulate.scenario import DriveSpec
from polemap.simulate.way import GRID_M, Way, make_way
from polemap.vehicle.pose import inverse_transform_points

Floats = NDArray[np.float64]
STEP_S = 0.005
# starts and stops are softened over this time, which the standstill pays for
_SOFTEN_S = 0.25
_SETTLE_S = 5 * _SOFTEN_S


@dataclass(frozen=True, slots=True)
class Motion:
    """The true motion of the rear axle, every 5 ms; every array `(n,)`.

    Attributes:
        stamp_s: from 0.
        pose: `(n, 3)` x, y, yaw (unwrapped) in the world's local metres.
        speed_mps, yaw_rate_radps, acceleration_mps2: along and about the rear axle.
        sideslip_rad, steering_rad: at the centre of gravity, and of the front wheels.
        lateral_m: position left of the route's centre line.
        wander_m: what the driver strays from the way planned, positive to the street's left.
        station_m: along the route, growing over the laps, falling on the way back of a U-turn.
        lap_starts_s: start of each lap, and the end of the last.
    """

    stamp_s: Floats
    pose: Floats
    speed_mps: Floats
    yaw_rate_radps: Floats
    acceleration_mps2: Floats
    sideslip_rad: Floats
    steering_rad: Floats
    lateral_m: Floats
    wander_m: Floats
    station_m: Floats
    lap_starts_s: Floats

    def at(self, stamps_s: Floats) -> Floats:
        """True poses `(m, 3)`, yaw unwrapped, linear between the 5 ms."""
        return np.stack([np.interp(stamps_s, self.stamp_s, self.pose[:, k]) for k in range(3)], 1)

    def value(self, name: str, stamps_s: Floats) -> Floats:
        """One of the other arrays at the stamps."""
        return np.asarray(np.interp(stamps_s, self.stamp_s, getattr(self, name)))


def drive_route(route: Route, spec: DriveSpec, laps: int, rng: np.random.Generator) -> Motion:
    """Drives `laps` laps of a closed route, or once along an open one.

    Raises:
        ConfigError: several laps of an open route, or a U-turn without room for it.
    """
    way = make_way(route, spec, laps)
    margin = 0.0 if route.closed else 2.0
    driven = way.driven_m
    wander = _wander(driven, way, laps, spec, rng)
    stops = [
        way.reached_m(lap * route.length_m + stop)
        for lap in range(laps)
        for stop in [0.0, *spec.stops_m]
    ]
    speed = _speed(route, way, margin, stops, spec, rng)
    time, at = _schedule(driven, speed, stops, spec)
    stamps = np.arange(0.0, time[-1], STEP_S)
    travelled = scipy.ndimage.gaussian_filter1d(
        np.interp(stamps, time, at), _SOFTEN_S / STEP_S, mode="nearest"
    )
    line = route.at(way.station_m + margin, way.lateral_m + wander)[:, :2]
    ride = follow(line, GRID_M, travelled, STEP_S, CAR)
    station = np.interp(travelled, driven, way.station_m) + margin
    middle = route.at(station)
    beside = inverse_transform_points(middle, ride.pose[:, :2])[:, 1]
    starts = np.interp(way.lap_starts_m - 1e-6, at, time)
    # the standstill belongs to the lap that it opens
    first = [float(time[np.searchsorted(at, start - 1e-9)]) for start in way.lap_starts_m[:-1]]
    return Motion(
        stamps,
        ride.pose,
        ride.speed_mps,
        ride.yaw_rate_radps,
        np.gradient(ride.speed_mps, STEP_S),
        ride.sideslip_rad,
        ride.steering_rad,
        beside,
        beside - np.interp(travelled, driven, way.lateral_m),
        station,
        np.array([*first, min(float(starts[-1]), float(stamps[-1]))]),
    )


def _wander(
    driven: Floats, way: Way, laps: int, spec: DriveSpec, rng: np.random.Generator
) -> Floats:
    """Smooth straying from the lane's middle, of another strength in every lap, plus evasions."""
    noise = rng.standard_normal(len(driven))
    smooth = 0.8 * _unit(scipy.ndimage.gaussian_filter1d(noise, 11.0 / GRID_M, mode="nearest"))
    smooth += 0.6 * _unit(
        scipy.ndimage.gaussian_filter1d(
            rng.standard_normal(len(driven)), 35.0 / GRID_M, mode="nearest"
        )
    )
    lap = np.searchsorted(way.lap_starts_m, driven, side="right") - 1
    strength = rng.uniform(*spec.wander_sd_m, laps)[np.minimum(lap, laps - 1)]
    smooth = 2.5 * np.tanh(smooth / 2.5)
    wander = smooth * scipy.ndimage.gaussian_filter1d(strength, 8.0 / GRID_M, mode="nearest")
    for _ in range(int(rng.poisson(spec.evasions * laps))):
        middle, width = rng.uniform(25.0, max(26.0, driven[-1] - 25.0)), rng.uniform(6.0, 9.0)
        bulge = np.exp(-0.5 * ((driven - middle) / width) ** 2)
        wander = wander + rng.uniform(1.0, 1.7) * bulge
    return np.asarray(wander)


def _unit(values: Floats) -> Floats:
    return np.asarray(values / max(float(values.std()), 1e-12))


def _speed(
    route: Route,
    way: Way,
    margin: float,
    stops: list[float],
    spec: DriveSpec,
    rng: np.random.Generator,
) -> Floats:
    """Speed over the way: limit, bends, stops, and what the car can gain or shed."""
    station = way.driven_m
    bend = np.abs(route.curvature_at(way.station_m + margin)) + way.bend_1pm
    mood = 1 + 0.08 * _unit(
        scipy.ndimage.gaussian_filter1d(rng.standard_normal(len(station)), 60.0 / GRID_M)
    )
    limit = np.minimum(
        spec.speed_mps * mood, np.sqrt(spec.lateral_acceleration_mps2 / np.maximum(bend, 1e-4))
    )
    for stop in [*stops, float(station[-1])]:
        limit[np.argmin(np.abs(station - stop))] = 0.0
    square = limit**2
    gain = 2 * spec.acceleration_mps2 * GRID_M
    for order in (range(1, len(square)), range(len(square) - 2, -1, -1)):
        back = -1 if order.step > 0 else 1
        for i in order:
            square[i] = min(square[i], square[i + back] + gain)
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def _schedule(
    station: Floats, speed: Floats, stops: list[float], spec: DriveSpec
) -> tuple[Floats, Floats]:
    """Time at which each place is reached, with the standstill at every stop spelled out."""
    mean = np.maximum((speed[1:] + speed[:-1]) / 2, 0.15)
    time = np.concatenate([[0.0], np.cumsum(np.diff(station) / mean)])
    at = station.copy()
    for stop in sorted(stops, reverse=True):
        i = int(np.argmin(np.abs(station - stop)))
        pause = spec.standstill_s + _SETTLE_S
        time[i + 1 :] += pause
        time = np.insert(time, i + 1, time[i] + pause)
        at = np.insert(at, i + 1, station[i])
        # indices above i moved by one, those of the earlier stops did not
        station = at
    return np.asarray(time), np.asarray(at)
