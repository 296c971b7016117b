"""A constant error of all disparities, learned on the way from tracked poles and odometry.

A camera that is turned out of true by some hundredths of a degree about the upright axis
measures every disparity too large or too small by the same tenths of a pixel. Near poles hardly
show it, far ones stand decimetres off: range is wrong by range^2 / (focal length x baseline) a
pixel, so a pole that stands still seems to move while the car drives toward it. All sightings of a
track give its place and the offset by least squares; the offsets of the tracks are averaged by
their information.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from polemap.config import TrackingConfig
from polemap.tracking import Motion, Sighting, Tracks
from stereo.rig import StereoRig

Floats = NDArray[np.float64]

_OVER_S = 1.0  # not seen for so long, a track is over
_LEAST_SPAN_M = 3.0
_LARGEST_SD = 3.0  # a track that contradicts the others by more was mixed up


@dataclass(slots=True)
class _Sum:
    """Normal equations of one track: place (2) in the dead-reckoned frame, offset; ranges seen."""

    information: Floats = field(default_factory=lambda: np.zeros((3, 3)))
    weighted: Floats = field(default_factory=lambda: np.zeros(3))
    nearest_m: float = np.inf
    farthest_m: float = 0.0
    confirmed: bool = False
    seen_s: float = 0.0


class DisparityOffset:
    """What has to be added to every disparity, with its standard deviation."""

    def __init__(self, rig: StereoRig, config: TrackingConfig) -> None:
        self._config = config
        camera = rig.vehicle_from_camera
        self._origin_m = np.array([camera.x_m, camera.y_m])
        self._ahead = np.array([np.cos(camera.yaw_rad), np.sin(camera.yaw_rad)])
        self._focal_baseline = rig.focal_px * rig.baseline_m
        self._sums: dict[int, _Sum] = {}
        self._pose = np.zeros(3)
        self._ended = (0.0, config.disparity_offset_sd_px**2)
        self.value_px, self._variance = self._ended

    @property
    def sd_px(self) -> float:
        """Standard deviation of the value."""
        return float(np.sqrt(self._variance))

    def clear(self) -> None:
        """Forget the tracks; what was learned stays."""
        self._sums.clear()

    def move(self, motion: Motion) -> None:
        """Dead reckoning between two frames."""
        east, north, yaw = self._pose
        c, s = np.cos(yaw), np.sin(yaw)
        self._pose = np.array(
            [
                east + c * motion.forward_m - s * motion.left_m,
                north + s * motion.forward_m + c * motion.left_m,
                yaw + motion.turn_rad,
            ]
        )

    def corrected(self, points_vehicle_m: Floats) -> Floats:
        """Points `(n, 2)` from the camera's own disparities, moved by the present value."""
        ray = points_vehicle_m - self._origin_m
        short = 1.0 + self.value_px * (ray @ self._ahead) / self._focal_baseline
        return np.asarray(self._origin_m + ray / short[:, np.newaxis])

    def see(self, sighting: Sighting, tracks: Tracks, elapsed_s: float) -> None:
        """Add the detections that tracks took; tracks that ended count for good.

        Args:
            sighting: of corrected points.
            tracks: after their update with it.
            elapsed_s: time since the frame before, inf for the first.
        """
        time_s = self._config.error_time_s
        # errors of a stem last: a frame is worth as much as its part of two correlation times
        share = min(1.0, elapsed_s / (2.0 * time_s)) if time_s > 0 else 1.0
        c, s = np.cos(self._pose[2]), np.sin(self._pose[2])
        turn = np.array([[c, -s], [s, c]])
        for row in np.flatnonzero(tracks.detection >= 0):
            which = tracks.detection[row]
            point = sighting.points_vehicle_m[which]
            ray = point - self._origin_m
            away = float(np.hypot(*ray))
            # one pixel more makes the range shorter by range / disparity
            step = turn @ (-ray * float(ray @ self._ahead) / self._focal_baseline)
            design = np.concatenate([np.eye(2), -step[:, None]], axis=1)
            placed = self._pose[:2] + turn @ point - step * self.value_px
            weight = share * np.linalg.inv(turn @ sighting.covariance_m2[which] @ turn.T)
            total = self._sums.setdefault(int(tracks.ids[row]), _Sum())
            total.information += design.T @ weight @ design
            total.weighted += design.T @ weight @ placed
            total.nearest_m = min(total.nearest_m, away)
            total.farthest_m = max(total.farthest_m, away)
            total.confirmed |= bool(tracks.confirmed[row])
            total.seen_s = sighting.stamp_s
        for identity in [k for k, t in self._sums.items() if sighting.stamp_s - t.seen_s > _OVER_S]:
            said = self._said(self._sums.pop(identity))
            if said is not None:
                self._ended = _combined(self._ended, *said)
        estimate = self._ended
        for said in map(self._said, self._sums.values()):
            if said is not None:
                estimate = _combined(estimate, *said)
        self.value_px, self._variance = estimate

    def _said(self, total: _Sum) -> tuple[float, float] | None:
        """Offset and variance by one track; None if it says nothing or contradicts the others."""
        if not total.confirmed or total.farthest_m - total.nearest_m < _LEAST_SPAN_M:
            return None
        place, cross = total.information[:2, :2], total.information[:2, 2]
        reduced = np.linalg.solve(place, np.stack([cross, total.weighted[:2]], axis=1))
        known = float(total.information[2, 2] - cross @ reduced[:, 0])
        if known <= 0.0:
            return None
        offset = float(total.weighted[2] - cross @ reduced[:, 1]) / known
        # a wrong scale of the odometry looks like an offset
        scale = self._config.speed_sd_share * self._focal_baseline
        variance = 1.0 / known + (scale / (total.nearest_m + total.farthest_m)) ** 2
        value, spread = self._ended
        if (offset - value) ** 2 > _LARGEST_SD**2 * (spread + variance):
            return None
        return offset, variance


def _combined(estimate: tuple[float, float], offset: float, variance: float) -> tuple[float, float]:
    value, spread = estimate
    gain = spread / (spread + variance)
    return value + gain * (offset - value), (1.0 - gain) * spread
