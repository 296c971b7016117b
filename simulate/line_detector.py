"""Pieces of lines as a detector reports them, drawn from stated errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle
from polemap.drivelog.line_detections import LineDetections
from polemap.simulate.config import LineDetectorConfig
from polemap.simulate.street_lines import StreetLine
from polemap.vehicle.pose import inverse_transform_points, rotate

Floats = NDArray[np.float64]

_NEAR_M, _SIDE_M = 3.0, 10.0
_LEAST_PIECE_M = 1.0
_CLUTTER_M = (2.0, 6.0)
_PROBABILITY = 0.9


class LineDetector:
    """What a detector sees of lines, scan by scan.

    The error across is made of a part that all pieces of a scan share, to the car's left, a part
    that lasts from scan to scan for all of them, and a part of each piece.

    Args:
        lines: what there is, in the frame of the poses.
        config: how well it is seen.
        rng: all randomness.
    """

    def __init__(
        self, lines: Sequence[StreetLine], config: LineDetectorConfig, rng: np.random.Generator
    ) -> None:
        self._config, self._rng = config, rng
        none = np.empty((0, 2))
        self._points = np.concatenate([none, *(line.points_m for line in lines)])
        counts = [len(line.points_m) for line in lines]
        self._line = np.repeat(np.arange(len(lines)), counts)
        self._seen = np.concatenate([np.empty(0, np.bool_), *(line.seen for line in lines)])
        self._lines = tuple(lines)
        self._lasting, self._last_s = rng.standard_normal(), -np.inf

    def scan(self, stamp_s: float, pose: Floats) -> LineDetections:
        """The lines seen from a rear-axle pose `(3,)`."""
        config, rng = self._config, self._rng
        keep = np.exp(-(stamp_s - self._last_s) / config.lasting_s)
        keep = keep if np.isfinite(self._last_s) else 1.0
        self._lasting = keep * self._lasting + np.sqrt(1.0 - keep**2) * rng.standard_normal()
        self._last_s = stamp_s
        shared = np.sqrt(config.frame_share) * rng.standard_normal()
        shared += np.sqrt(config.lasting_share) * self._lasting
        rows = [self._piece(shared, *piece) for piece in self._pieces(pose)]
        rows += [self._ghost() for _ in range(rng.poisson(config.clutter_per_scan))]
        return LineDetections.concatenate([LineDetections.none(), *rows])

    def _pieces(self, pose: Floats) -> list[tuple[StreetLine, Floats]]:
        """Points in the vehicle frame of every piece that is detected."""
        config = self._config
        near = np.flatnonzero(
            np.hypot(*(self._points - pose[:2]).T) < np.hypot(config.range_max_m, _SIDE_M)
        )
        local = inverse_transform_points(pose, self._points[near])
        inside = (local[:, 0] > _NEAR_M) & (local[:, 0] < config.range_max_m)
        inside &= (np.abs(local[:, 1]) < _SIDE_M) & self._seen[near]
        near, local = near[inside], local[inside]
        # a piece is what lies on one line without a gap, in one window of the road ahead
        window = np.floor((local[:, 0] - _NEAR_M) / config.piece_m).astype(np.int64)
        apart = (np.diff(near) != 1) | (np.diff(window) != 0)
        apart |= np.diff(self._line[near]) != 0
        found = []
        for rows in np.split(np.arange(len(near)), np.flatnonzero(apart) + 1):
            long_enough = len(rows) >= 2 and (
                np.hypot(*(local[rows[-1]] - local[rows[0]])) >= _LEAST_PIECE_M
            )
            if long_enough and self._rng.random() < config.detected_share:
                found.append((self._lines[int(self._line[near[rows[0]]])], local[rows]))
        return found

    def _piece(self, shared: float, line: StreetLine, points: Floats) -> LineDetections:
        """A straight piece through points `(k, 2)`, with its errors."""
        config, rng = self._config, self._rng
        middle = points.mean(axis=0)
        along = np.linalg.svd(points - middle, full_matrices=False)[2][0]
        along = along if along[0] >= 0 else -along
        half = 0.5 * float(np.hypot(*(points[-1] - points[0])))
        across = np.array([-along[1], along[0]])
        sd = float(np.hypot(config.offset_sd_m, config.offset_sd_per_m * np.hypot(*middle)))
        own = np.sqrt(1.0 - config.frame_share - config.lasting_share) * rng.standard_normal()
        # what all share is the car's: to its left, whatever way a piece points
        offset = sd * (shared * across[1] + own)
        turn = config.direction_sd_rad * rng.standard_normal()
        ends = middle + offset * across + rotate(np.outer([-half, half], along), turn)
        return _one(line.kind, line.style, ends, sd, config.direction_sd_rad)

    def _ghost(self) -> LineDetections:
        """An edge of a shadow, a tar seam: any direction within half a right angle."""
        config, rng = self._config, self._rng
        kind = LandmarkKind(int(rng.choice([LandmarkKind.LANE_MARKING, LandmarkKind.KERB])))
        middle = np.array([rng.uniform(_NEAR_M, config.range_max_m), rng.uniform(-8.0, 8.0)])
        half, turn = rng.uniform(*_CLUTTER_M) / 2, rng.uniform(-np.pi / 4, np.pi / 4)
        ends = middle + np.outer([-half, half], [np.cos(turn), np.sin(turn)])
        sd = float(np.hypot(config.offset_sd_m, config.offset_sd_per_m * np.hypot(*middle)))
        return _one(kind, LineStyle.UNKNOWN, ends, sd, config.direction_sd_rad)


def _one(kind: int, style: int, ends: Floats, sd_m: float, turn_sd: float) -> LineDetections:
    return LineDetections(
        kind=np.array([kind], dtype=np.int8),
        style=np.array([style], dtype=np.int8),
        start_vehicle_m=ends[:1],
        end_vehicle_m=ends[1:],
        offset_sd_m=np.array([sd_m]),
        direction_sd_rad=np.array([turn_sd]),
        probability=np.array([_PROBABILITY]),
    )
