"""The mean path of several passes and the coordinates along it.

A place is given by its station (metres along the path) and its deviation (metres to the left of
the path, on the path's normal). Both are found on a cubic spline, so that neither the spacing of
the stations nor that of the poses enters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]

STATION_STEP_M = 0.5
SMOOTHING_M = 2.0
REACH_M = 12.0
_TRACK_STEP_M = 2.0
_NEWTON_STEPS = 6
_START_REACH_M = 40.0


@dataclass(frozen=True, slots=True)
class MeanPath:
    """A smooth path through `points_m` `(k, 2)` at the equally spaced `station_m` `(k,)`."""

    station_m: Floats
    points_m: Floats
    _spline: scipy.interpolate.CubicSpline

    @staticmethod
    def through(points_m: Floats, step_m: float = STATION_STEP_M) -> MeanPath:
        """Equal stations along the polyline `points_m` `(n, 2)`, which must not be a point."""
        distance = _polyline_length(points_m)
        keep = np.concatenate([[True], np.diff(distance) > 1e-9])
        distance, points_m = distance[keep], points_m[keep]
        if len(points_m) >= 3:
            curve = scipy.interpolate.CubicSpline(distance, points_m, axis=0)
            fine = np.linspace(0.0, distance[-1], max(4 * len(points_m), 16))
            samples = np.asarray(curve(fine))
        else:
            samples = points_m
        length = _polyline_length(samples)
        count = max(round(length[-1] / step_m), 3)
        station = np.linspace(0.0, length[-1], count + 1)
        points = np.column_stack([np.interp(station, length, samples[:, i]) for i in (0, 1)])
        return MeanPath(station, points, scipy.interpolate.CubicSpline(station, points, axis=0))

    @property
    def length_m(self) -> float:
        """From the first to the last station."""
        return float(self.station_m[-1])

    def at(self, station_m: Floats) -> tuple[Floats, Floats, Floats]:
        """Position, first and second derivative `(m, 2)` each; straight beyond both ends."""
        inside = np.clip(station_m, 0.0, self.length_m)
        beyond = np.asarray(station_m - inside)[:, None]
        first = np.asarray(self._spline(inside, 1))
        position = np.asarray(self._spline(inside)) + beyond * first
        second = np.where(beyond == 0.0, np.asarray(self._spline(inside, 2)), 0.0)
        return position, first, second

    def heading_rad(self, station_m: Floats) -> Floats:
        """Direction of the path, `(m,)`, counter-clockwise from east."""
        _, tangent, _ = self.at(station_m)
        return np.asarray(np.arctan2(tangent[:, 1], tangent[:, 0]))

    def project(self, points_m: Floats, guess_m: Floats) -> tuple[Floats, Floats]:
        """Station and deviation `(n,)` of `points_m` `(n, 2)`, NaN where the path is out of reach.

        Newton's method on (p - c(s)) . c'(s) = 0 from `guess_m` `(n,)`; a point that is further
        than `REACH_M` from the path, or whose foot is not found, is not on this path.
        """
        station = np.array(guess_m, dtype=np.float64)
        for _ in range(_NEWTON_STEPS):
            position, first, second = self.at(station)
            offset = points_m - position
            slope = np.sum(first * first, axis=1) - np.sum(offset * second, axis=1)
            step = np.sum(offset * first, axis=1) / np.maximum(slope, 0.2)
            station = station + np.clip(step, -8.0, 8.0)
        position, first, _ = self.at(station)
        offset = points_m - position
        speed = np.hypot(first[:, 0], first[:, 1])
        missed = np.abs(np.sum(offset * first, axis=1)) / speed
        deviation = (first[:, 0] * offset[:, 1] - first[:, 1] * offset[:, 0]) / speed
        lost = ~(missed < 0.01) | (np.abs(deviation) > REACH_M)
        return np.where(lost, np.nan, station), np.where(lost, np.nan, deviation)

    def track(self, trajectory: Trajectory, start_m: float = 0.0) -> tuple[Floats, Floats]:
        """Follow one pass along the path: stamps and stations `(m,)` about every two metres.

        The pass starts near station `start_m`, and the station may only move on little by
        little, so that a path that crosses or touches itself stays unambiguous. These are the
        first guesses of `project`.
        """
        coarse = trajectory.thinned(_TRACK_STEP_M)
        if len(coarse) == 0:
            return np.empty(0), np.empty(0)
        step = self.station_m[1]
        back, ahead = int(10.0 / step), int(20.0 / step)
        points = coarse.poses[:, :2]
        low = max(int((start_m - _START_REACH_M) / step), 0)
        high = max(int((start_m + _START_REACH_M) / step), low + 2)
        here = low + int(np.argmin(_squared(self.points_m[low:high] - points[0])))
        station = np.empty(len(points))
        for row, point in enumerate(points):
            low = max(here - back, 0)
            window = _squared(self.points_m[low : here + ahead] - point)
            here = low + int(np.argmin(window))
            station[row] = self.station_m[here]
        return coarse.stamp_s, station


def mean_path(passes: Sequence[Trajectory], rounds: int = 2) -> MeanPath:
    """The pointwise median of several passes in the same direction, smoothed.

    Starts from the longest pass that is not an outlier (1.1 median lengths); in every round the
    path moves along its normals by the median deviation of the passes, smoothed over
    `SMOOTHING_M`. A common shift of the path does not change a repeatability, since deviations
    are centred at every station.
    """
    lengths = np.array([one.thinned(_TRACK_STEP_M).travelled_m()[-1] for one in passes])
    seed = int(np.argmax(np.where(lengths <= 1.1 * np.median(lengths), lengths, 0.0)))
    path = MeanPath.through(smooth_line(passes[seed].thinned(STATION_STEP_M).poses[:, :2]))
    if len(passes) < 2:
        return path
    thin = [one.thinned(STATION_STEP_M) for one in passes]
    guesses = [_rough(path, one) for one in thin]
    for _ in range(rounds):
        deviations = np.full((len(passes), len(path.station_m)), np.nan)
        for row, (one, guess) in enumerate(zip(thin, guesses, strict=True)):
            if guess is None:
                continue
            station, deviation = path.project(one.poses[:, :2], guess)
            order = np.argsort(station, kind="stable")
            order = order[np.isfinite(station[order])]
            if len(order) > 1:
                deviations[row] = np.interp(
                    path.station_m, station[order], deviation[order], left=np.nan, right=np.nan
                )
        known = np.isfinite(deviations).any(axis=0)
        if not known.any():
            break
        shift = np.zeros(len(path.station_m))
        shift[known] = np.nanmedian(deviations[:, known], axis=0)
        shift = scipy.ndimage.gaussian_filter1d(shift, SMOOTHING_M / STATION_STEP_M, mode="nearest")
        _, tangent, _ = path.at(path.station_m)
        normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
        normal /= np.hypot(normal[:, 0], normal[:, 1])[:, None]
        moved = MeanPath.through(path.points_m + shift[:, None] * normal)
        stretch = moved.length_m / path.length_m
        guesses = [None if guess is None else guess * stretch for guess in guesses]
        path = moved
    return path


def _rough(path: MeanPath, one: Trajectory) -> Floats | None:
    """First guesses of the stations of a pass."""
    stamps, stations = path.track(one)
    return np.interp(one.stamp_s, stamps, stations) if len(stamps) > 1 else None


def smooth_line(points_m: Floats, smoothing_m: float = SMOOTHING_M) -> Floats:
    """A polyline `(n, 2)` resampled at equal steps and smoothed by a Gaussian; ends are kept."""
    distance = _polyline_length(points_m)
    count = max(int(distance[-1] / STATION_STEP_M), 3)
    even = np.linspace(0.0, distance[-1], count + 1)
    line = np.column_stack([np.interp(even, distance, points_m[:, i]) for i in (0, 1)])
    # Odd reflection about the ends keeps the ends and their direction.
    width = min(int(4 * smoothing_m / STATION_STEP_M), count)
    padded = np.pad(line, ((width, width), (0, 0)), mode="reflect", reflect_type="odd")
    smooth = scipy.ndimage.gaussian_filter1d(padded, smoothing_m / STATION_STEP_M, axis=0)
    return np.asarray(smooth[width : width + count + 1])


def _polyline_length(points_m: Floats) -> Floats:
    steps = np.hypot(*np.diff(points_m, axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _squared(offset: Floats) -> Floats:
    return np.asarray(offset[:, 0] ** 2 + offset[:, 1] ** 2)
