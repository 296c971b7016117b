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
from polemap.tracks import Motion, Sighting, Tracks
from stereo.rig import StereoRig

Floats = NDArray[np.float64]

_OVER_S = 1.0  # not seen for so long, a track is over
_LEAST_SPAN_M = 1.5
_LEAST_VARIANCE = 1e-12
_STEM_SD_PX = 0.15  # measured on simulated stems; leaves and thin posts have more
_LARGEST_SD = 3.0  # a track that contradicts the others by more was mixed up


@dataclass(slots=True)
class _Sum:
    """Normal equations of one track: place (2) in the dead-reckoned frame, offset, scale."""

    start_m: Floats
    born_s: float
    information: Floats = field(default_factory=lambda: np.zeros((4, 4)))
    weighted: Floats = field(default_factory=lambda: np.zeros(4))
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
        self._variance = config.disparity_offset_sd_px**2
        self.value_px = 0.0
        # information on (offset, scale of the odometry), and what it is multiplied with
        least = np.maximum([self._variance, config.speed_sd_share**2], _LEAST_VARIANCE)
        self._ended = np.diag(1.0 / least), np.zeros(2)

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

    def per_px(self, points_vehicle_m: Floats) -> Floats:
        """How points `(n, 2)` move if the disparities are one pixel more: nearer along the ray."""
        ray = points_vehicle_m - self._origin_m
        return np.asarray(-ray * (ray @ self._ahead)[:, np.newaxis] / self._focal_baseline)

    def see(self, sighting: Sighting, tracks: Tracks, elapsed_s: float) -> None:
        """Add the detections that tracks took; tracks that ended count for good.

        Args:
            sighting: of corrected points.
            tracks: after their update with it.
            elapsed_s: time since the frame before, inf for the first.
        """
        if self._config.disparity_offset_sd_px == 0.0:
            return
        time_s = self._config.error_time_s
        # errors of a stem last: a frame is worth as much as its part of two correlation times
        share = min(1.0, elapsed_s / (2.0 * time_s)) if time_s > 0 else 1.0
        c, s = np.cos(self._pose[2]), np.sin(self._pose[2])
        turn = np.array([[c, -s], [s, c]])
        for row in np.flatnonzero(tracks.detection >= 0):
            which = tracks.detection[row]
            point = sighting.points_vehicle_m[which]
            away = float(np.hypot(*(point - self._origin_m)))
            step = turn @ self.per_px(point[np.newaxis])[0]
            total = self._sums.get(int(tracks.ids[row]))
            if total is None:
                total = self._sums[int(tracks.ids[row])] = _Sum(
                    self._pose[:2].copy(), sighting.stamp_s
                )
            travel = self._pose[:2] - total.start_m
            design = np.column_stack([np.eye(2), -step, -travel])
            placed = self._pose[:2] + turn @ point - step * self.value_px
            aside = np.array([-step[1], step[0]]) / np.hypot(*step)
            turned = self._config.yaw_rate_sd_radps * (sighting.stamp_s - total.born_s) * away
            spread = turn @ sighting.covariance_m2[which] @ turn.T
            spread = spread + turned**2 * np.outer(aside, aside)
            weight = share * np.linalg.inv(spread)
            total.information += design.T @ weight @ design
            total.weighted += design.T @ weight @ placed
            total.nearest_m = min(total.nearest_m, away)
            total.farthest_m = max(total.farthest_m, away)
            total.confirmed |= bool(tracks.confirmed[row])
            total.seen_s = sighting.stamp_s
        for identity in [k for k, t in self._sums.items() if sighting.stamp_s - t.seen_s > _OVER_S]:
            self._ended = self._with(self._ended, self._sums.pop(identity))
        estimate = self._ended
        for total in self._sums.values():
            estimate = self._with(estimate, total)
        spread = np.linalg.inv(estimate[0])
        self.value_px, self._variance = float(spread[0] @ estimate[1]), float(spread[0, 0])

    def _with(self, known: tuple[Floats, Floats], total: _Sum) -> tuple[Floats, Floats]:
        """What is known and what one track says, unless it says nothing or contradicts."""
        if not total.confirmed or total.farthest_m - total.nearest_m < _LEAST_SPAN_M:
            return known
        place, cross = total.information[:2, :2], total.information[:2, 2:]
        reduced = np.linalg.solve(place, np.column_stack([cross, total.weighted[:2]]))
        said = total.information[2:, 2:] - cross.T @ reduced[:, :2]
        weighted = total.weighted[2:] - cross.T @ reduced[:, 2]
        # every stem has an error of its own, which no number of frames averages out
        first = said[:, 0] / (_STEM_SD_PX**-2 + said[0, 0])
        said, weighted = said - np.outer(first, said[0]), weighted - first * weighted[0]
        before, after = np.linalg.inv(known[0]), np.linalg.inv(known[0] + said)
        change = float(after[0] @ (known[1] + weighted) - before[0] @ known[1])
        # the estimate moves by the difference of the variances' root at one sigma
        if change**2 > _LARGEST_SD**2 * max(before[0, 0] - after[0, 0], 1e-12):
            return known
        return known[0] + said, known[1] + weighted
