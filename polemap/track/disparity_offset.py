"""A constant error of all disparities, learned on the way from tracked poles and odometry.

A camera that is turned out of true by some hundredths of a degree about the upright axis
measures every disparity too large or too small by the same tenths of a pixel. Near poles hardly
show it, far ones stand decimetres off: range is wrong by range^2 / (focal length x baseline) a
pixel, so a pole that stands still seems to move while the car drives toward it. An odometry that
tells too long or too short a way moves it alike, so the odometry's scale is solved along with the
offset. All detections of a track give its place, offset and scale by least squares; what the tracks
say of the latter two is averaged by their information.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.line_detections import LineDetections
from polemap.stereo.rig import StereoRig
from polemap.track.config import TrackingConfig
from polemap.track.constants import ERROR_TIME_S
from polemap.track.tracks import Motion, Tracks
from polemap.vehicle.pose import compose, rotate, rotation

Floats = NDArray[np.float64]

_OVER_S = 1.0  # not seen for so long, a track is over
_LEAST_SPAN_M = 1.5
_LEAST_VARIANCE = 1e-12  # keeps what is known for sure, or did not change, from dividing by zero
_POLE_SD_PX = 0.15  # measured on simulated poles; leaves and thin posts have more
_LARGEST_SD = 3.0  # a track that contradicts the others by more was mixed up


@dataclass(slots=True)
class _NormalEquations:
    """Normal equations of one track: place (2) in the dead-reckoned frame, offset, scale."""

    start_m: Floats
    born_s: float
    information: Floats = field(default_factory=lambda: np.zeros((4, 4)))
    weighted: Floats = field(default_factory=lambda: np.zeros(4))
    nearest_m: float = np.inf
    farthest_m: float = 0.0
    confirmed: bool = False
    seen_s: float = 0.0

    def add(self, place_m: Floats, design: Floats, covariance_m2: Floats, share: float) -> None:
        """Add a detection that says: `place_m` `(2,)` is `design` `(2, 4)` times the unknowns.

        Args:
            covariance_m2: `(2, 2)` of the place.
            share: the part of an independent detection that it is worth.
        """
        weight = share * np.linalg.inv(covariance_m2)
        self.information += design.T @ weight @ design
        self.weighted += design.T @ weight @ place_m

    def note(self, stamp_s: float, away_m: float, confirmed: bool) -> None:
        """Keep when and from how far it was seen, and whether the track was sure by then."""
        self.nearest_m = min(self.nearest_m, away_m)
        self.farthest_m = max(self.farthest_m, away_m)
        self.confirmed |= confirmed
        self.seen_s = stamp_s


class DisparityOffset:
    """What has to be added to every disparity, with its standard deviation."""

    def __init__(self, rig: StereoRig, config: TrackingConfig) -> None:
        self._config = config
        self._rig = rig
        self._origin_m, self._ahead = _line_of_sight(rig)
        self._focal_baseline = rig.focal_px * rig.baseline_m
        self._sums: dict[int, _NormalEquations] = {}
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

    def forget_tracks(self) -> None:
        """Forget the tracks; what was learned stays."""
        self._sums.clear()

    def dead_reckon(self, motion: Motion) -> None:
        """Dead reckoning between two frames."""
        self._pose = compose(self._pose, [motion.forward_m, motion.left_m, motion.turn_rad])

    def corrected(self, points_vehicle_m: Floats) -> Floats:
        """Points `(n, 2)` from the camera's own disparities, moved by the present value."""
        return with_disparity(points_vehicle_m, self.value_px, self._rig)

    def shift_per_px(self, points_vehicle_m: Floats) -> Floats:
        """How points `(n, 2)` move if the disparities are one pixel more: nearer along the ray."""
        ray = points_vehicle_m - self._origin_m
        return np.asarray(-ray * (ray @ self._ahead)[:, np.newaxis] / self._focal_baseline)

    def corrected_lines(self, lines: LineDetections) -> LineDetections:
        """Lines from the camera's own disparities, moved and turned by the present value.

        What is not known of it yet is added to their deviations: it shifts a line across by its
        share of the distance from the camera's foot, far ends more than near ones.
        """
        ends = [self.corrected(end) for end in (lines.start_vehicle_m, lines.end_vehicle_m)]
        moved = lines.with_columns(start_vehicle_m=ends[0], end_vehicle_m=ends[1])
        across = rotate(np.array([0.0, 1.0]), moved.direction_rad)
        shift = [np.sum(self.shift_per_px(end) * across, axis=1) * self.sd_px for end in ends]
        turn = (shift[1] - shift[0]) / moved.length_m
        return moved.with_columns(
            offset_sd_m=np.hypot(lines.offset_sd_m, 0.5 * (shift[0] + shift[1])),
            direction_sd_rad=np.hypot(lines.direction_sd_rad, turn),
        )

    def learn_from_tracks(self, detections: Detections, tracks: Tracks, elapsed_s: float) -> None:
        """Add the detections that tracks took; tracks that ended count for good.

        Args:
            detections: of corrected points.
            tracks: after their update with it.
            elapsed_s: time since the frame before, inf for the first.
        """
        if self._config.disparity_offset_sd_px == 0.0:
            return
        # errors of a pole last: a frame is worth as much as its part of two correlation times
        share = min(1.0, elapsed_s / (2.0 * ERROR_TIME_S))
        for row in np.flatnonzero(tracks.detection >= 0):
            which = int(tracks.detection[row])
            away_m = float(np.hypot(*(detections.points_vehicle_m[which] - self._origin_m)))
            total = self._sums.get(int(tracks.ids[row]))
            if total is None:
                total = self._sums[int(tracks.ids[row])] = _NormalEquations(
                    self._pose[:2].copy(), detections.stamp_s
                )
            self._add(total, detections, which, away_m, share)
            total.note(detections.stamp_s, away_m, bool(tracks.confirmed[row]))
        for identity in [
            k for k, t in self._sums.items() if detections.stamp_s - t.seen_s > _OVER_S
        ]:
            self._ended = self._with(self._ended, self._sums.pop(identity))
        estimate = self._ended
        for total in self._sums.values():
            estimate = self._with(estimate, total)
        covariance = np.linalg.inv(estimate[0])
        self.value_px = float(covariance[0] @ estimate[1])
        self._variance = float(covariance[0, 0])

    def _add(
        self,
        total: _NormalEquations,
        detections: Detections,
        which: int,
        away_m: float,
        share: float,
    ) -> None:
        """Add a detection to its track's sum, in the dead-reckoned frame."""
        point = detections.points_vehicle_m[which]
        turn = rotation(self._pose[2])
        step = turn @ self.shift_per_px(point[np.newaxis])[0]
        travel = self._pose[:2] - total.start_m
        design = np.column_stack([np.eye(2), -step, -travel])
        place = self._pose[:2] + turn @ point - step * self.value_px
        # dead reckoning turns away: what it says lies aside of the ray errs with age and distance
        aside = np.array([-step[1], step[0]]) / np.hypot(*step)
        turned = self._config.yaw_rate_sd_radps * (detections.stamp_s - total.born_s) * away_m
        spread = turn @ detections.covariance_m2[which] @ turn.T
        total.add(place, design, spread + turned**2 * np.outer(aside, aside), share)

    def _with(self, known: tuple[Floats, Floats], total: _NormalEquations) -> tuple[Floats, Floats]:
        """What is known and what one track says, unless it says nothing or contradicts."""
        if not total.confirmed or total.farthest_m - total.nearest_m < _LEAST_SPAN_M:
            return known
        place, cross = total.information[:2, :2], total.information[:2, 2:]
        reduced = np.linalg.solve(place, np.column_stack([cross, total.weighted[:2]]))
        said = total.information[2:, 2:] - cross.T @ reduced[:, :2]
        weighted = total.weighted[2:] - cross.T @ reduced[:, 2]
        # every pole has an error of its own, which no number of frames averages out
        first = said[:, 0] / (_POLE_SD_PX**-2 + said[0, 0])
        said, weighted = said - np.outer(first, said[0]), weighted - first * weighted[0]
        before, after = np.linalg.inv(known[0]), np.linalg.inv(known[0] + said)
        change = float(after[0] @ (known[1] + weighted) - before[0] @ known[1])
        # the estimate moves by the difference of the variances' root at one sigma
        if change**2 > _LARGEST_SD**2 * max(before[0, 0] - after[0, 0], _LEAST_VARIANCE):
            return known
        return known[0] + said, known[1] + weighted


def with_disparity(points_vehicle_m: Floats, more_px: float, rig: StereoRig) -> Floats:
    """The points `(n, 2)`, vehicle frame, with all disparities `more_px` greater."""
    origin_m, ahead = _line_of_sight(rig)
    ray = points_vehicle_m - origin_m
    short = 1.0 + more_px * (ray @ ahead) / (rig.focal_px * rig.baseline_m)
    return np.asarray(origin_m + ray / short[:, np.newaxis])


def _line_of_sight(rig: StereoRig) -> tuple[Floats, Floats]:
    """Place of the left camera and where it looks, `(2,)` each, vehicle frame."""
    camera = rig.vehicle_from_camera
    return (
        np.array([camera.x_m, camera.y_m]),
        rotate([1.0, 0.0], camera.yaw_rad),
    )
