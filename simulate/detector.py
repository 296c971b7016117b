"""Poles as a detector reports them, drawn from stated errors instead of seen in pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections, VisibleRegion, pole_detections
from polemap.simulate.config import DetectorConfig
from polemap.vehicle.pose import inverse_transform_points

Floats = NDArray[np.float64]

_CAMERA_M = np.array([1.5, 0.0])  # in the vehicle frame
_NEAREST_M = 3.0
_WIDTH_SD_M = 0.05  # of what lasts, and again of every scan
_LEAST_SD_M = 0.02  # along and across the line of sight, however near the pole
_GHOST_WIDTHS_M = (0.05, 0.6)
_EXISTENCE = 0.9


class PoleDetector:
    """What a detector sees of poles, scan by scan, with its errors; part of each one's error lasts.

    Args:
        points: `(n, 2)` where they stand, in the frame of the poses, metres.
        widths: `(n,)` metres.
        config: how well it detects.
        rng: all randomness.
        visibility: `(n,)` factor of the detected share; 1 by default.
        error_time_s: correlation time of the part that lasts; by default the whole drive.
    """

    def __init__(
        self,
        points: Floats,
        widths: Floats,
        config: DetectorConfig,
        rng: np.random.Generator,
        *,
        visibility: Floats | None = None,
        error_time_s: float = np.inf,
    ) -> None:
        self._points, self._widths, self._config, self._rng = points, widths, config, rng
        visible = np.ones(len(points)) if visibility is None else visibility
        self._share = config.detected_share * visible
        self._error_time_s, self._last_s = error_time_s, -np.inf
        self._view = VisibleRegion(
            _CAMERA_M,
            -config.half_view_rad,
            config.half_view_rad,
            _NEAREST_M,
            np.array([config.range_max_m]),
        )
        self._lasting = rng.standard_normal((len(points), 2))
        self._lasting_width = _WIDTH_SD_M * rng.standard_normal(len(points))

    def scan(self, stamp_s: float, pose: Floats) -> Detections:
        """The scan from a rear-axle pose `(3,)`."""
        return self.scan_with_rows(stamp_s, pose)[0]

    def scan_with_rows(self, stamp_s: float, pose: Floats) -> tuple[Detections, NDArray[np.int64]]:
        """The scan, and which of the points its first rows are; those that follow are none."""
        config, view, rng = self._config, self._view, self._rng
        self._forget(stamp_s)
        local = inverse_transform_points(pose, self._points)
        rows = np.flatnonzero(view.contains(local))
        rows = rows[rng.random(len(rows)) < self._share[rows]]
        noise = np.sqrt(config.correlated_share) * self._lasting[rows] + np.sqrt(
            1.0 - config.correlated_share
        ) * rng.standard_normal((len(rows), 2))
        seen, covariance = _measured(local[rows], noise, view, config)
        width = self._widths[rows] + self._lasting_width[rows]
        width = width + _WIDTH_SD_M * rng.standard_normal(len(rows))
        false = rng.poisson(config.clutter_share / (1.0 - config.clutter_share) * max(len(rows), 1))
        bearing = rng.uniform(view.bearing_min_rad, view.bearing_max_rad, false)
        distance = np.sqrt(rng.uniform(_NEAREST_M**2, config.range_max_m**2, false))
        ghosts = view.origin_vehicle_m + distance[:, None] * np.stack(
            [np.cos(bearing), np.sin(bearing)], axis=1
        )
        _, ghost_covariance = _measured(ghosts, np.zeros((false, 2)), view, config)
        count = len(rows) + false
        scan = pole_detections(
            stamp_s=stamp_s,
            arrival_s=stamp_s + config.latency_s,
            points_vehicle_m=np.vstack([seen, ghosts]),
            covariance_m2=np.concatenate([covariance, ghost_covariance]),
            width_m=np.concatenate([width, rng.uniform(*_GHOST_WIDTHS_M, false)]),
            probability=np.full(count, _EXISTENCE),
            view=view,
        )
        return scan, rows

    def _forget(self, stamp_s: float) -> None:
        """Let the part of the errors that lasts decay since the scan before."""
        if np.isfinite(self._error_time_s):
            keep = np.exp(-(stamp_s - self._last_s) / self._error_time_s)
            fresh = self._rng.standard_normal(self._lasting.shape)
            self._lasting = keep * self._lasting + np.sqrt(1.0 - keep**2) * fresh
        self._last_s = stamp_s


def _measured(
    local: Floats, noise: Floats, view: VisibleRegion, config: DetectorConfig
) -> tuple[Floats, Floats]:
    """Points `(n, 2)` with unit noise `(n, 2)` along and across the line of sight, and their
    covariances `(n, 2, 2)`."""
    ray = local - view.origin_vehicle_m
    distance = np.hypot(*ray.T)
    along = ray / distance[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    range_sd = np.maximum(config.range_sd_per_m2 * distance**2, _LEAST_SD_M)
    cross_sd = np.maximum(config.bearing_sd_rad * distance, _LEAST_SD_M)
    seen = local + along * (range_sd * noise[:, 0])[:, None]
    seen = seen + across * (cross_sd * noise[:, 1])[:, None]
    covariance = (
        along[:, :, None] * along[:, None, :] * (range_sd**2)[:, None, None]
        + across[:, :, None] * across[:, None, :] * (cross_sd**2)[:, None, None]
    )
    return seen, covariance
