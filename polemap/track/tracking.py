"""Poles as constant landmarks in the vehicle frame: odometry moves them, detections correct them.

Every track has a position with covariance, a width, and the log-odds that it exists. Tracks and
detections are assigned optimally within a gate on the squared Mahalanobis distance.

What all disparities share, an error of the camera, is no noise at all: every track keeps how it
leans on that error (a Schmidt filter's considered state), so that it can be moved when the error
is known better, and its covariance told with what is not known yet.

Errors of one pole's disparity hardly change from frame to frame, so a frame is not a fresh
measurement. They are modelled as exponentially correlated with `ERROR_TIME_S`; a white error of
variance R (1 + r) / (1 - r), r = exp(-dt / ERROR_TIME_S), is worth as much in the long run, and
that is what the filter is told. The first frame of a track counts with R itself.

Source: S16, section III-A; Y. Bar-Shalom et al. 2002, sections 5.2 and 8.2 for filter and
correlated noise; S. Schmidt 1966 for considered errors; S. Thrun et al. 2005, section 4.2 for the
log-odds.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.track.config import TrackingConfig
from polemap.track.constants import (
    DELETE_EXISTENCE,
    DETECTION_PROBABILITY,
    DRIFT_SD_MPS,
    ERROR_TIME_S,
    GATE_MAX_M,
    GATE_PROBABILITY,
    PERIOD_S,
    POLE_SHARE,
    SPEED_SD_MPS,
    WIDTH_SD_M,
)
from polemap.track.tracks import Motion, Tracks
from polemap.vehicle.kalman import chi_square_quantile
from polemap.vehicle.pose import rotation, wrap_angle

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_FORBIDDEN = 1e6
_LOG_ODDS_LIMIT = 5.0
_HIT_LIMIT = (-1.5, 2.0)  # one frame's say: a wrong structure is wrong in every frame
_HEIGHT_MEMORY = 20.0
_LATE_SHARE = 0.93  # of the free range within which a pole is expected


class PoleTracker:
    """Holds the tracks: `predict_tracks` by odometry, `correct_tracks` by detections."""

    def __init__(self, config: TrackingConfig) -> None:
        self._config = config
        self._gate = chi_square_quantile(GATE_PROBABILITY, 2)
        _ = scipy.optimize  # loaded here, so that no frame of a live car waits for it
        self._next_id = 0
        self._updated_s: float | None = None
        self.tracks = Tracks()

    def drop_tracks(self) -> None:
        """Forget all tracks; ids are not used again."""
        self.tracks = Tracks()

    def predict_tracks(self, motion: Motion) -> None:
        """Move the tracks into the vehicle frame after `motion`, with the noise of odometry."""
        tracks, config = self.tracks, self._config
        later_from_earlier = rotation(-motion.turn_rad)
        offset = tracks.points_vehicle_m - np.array([motion.forward_m, motion.left_m])
        points = offset @ later_from_earlier.T
        dt = abs(motion.dt_s)
        var_turn = (config.yaw_rate_sd_radps * dt) ** 2
        var_along = (config.speed_sd_share * motion.distance_m) ** 2
        var_along += (SPEED_SD_MPS * dt) ** 2
        by_turn = np.stack([points[:, 1], -points[:, 0]], axis=1)
        noise = var_turn * by_turn[:, :, None] * by_turn[:, None, :]
        noise[:, 0, 0] += var_along
        noise += (DRIFT_SD_MPS * dt) ** 2 * np.eye(2)
        covariance = later_from_earlier @ tracks.covariance_m2 @ later_from_earlier.T + noise
        self.tracks = tracks.with_columns(
            points_vehicle_m=points,
            covariance_m2=covariance,
            shift_per_px_m=tracks.shift_per_px_m @ later_from_earlier.T,
            facing_rad=tracks.facing_rad - motion.turn_rad,
        )

    def shift_tracks(self, change: float) -> None:
        """Move all tracks: the error that they share is known to differ by `change` from before."""
        points = self.tracks.points_vehicle_m + change * self.tracks.shift_per_px_m
        self.tracks = self.tracks.with_columns(points_vehicle_m=points)

    def correct_tracks(self, detections: Detections) -> Ints:
        """Correct, bear, confirm and delete; returns each detection's track id, -1 for none."""
        config = self._config
        dt = detections.stamp_s - self._updated_s if self._updated_s is not None else np.inf
        self._updated_s = detections.stamp_s
        pace = min(max(dt / PERIOD_S, 0.0), 1.0)  # more frames are not more evidence
        pairs = self._assign(detections)
        tracks = self._correct(pairs, detections, dt, pace)
        tracks = self._miss(tracks, detections, pace)
        ids = np.full(len(detections.probability), -1, dtype=np.int64)
        ids[pairs[1]] = tracks.ids[pairs[0]]
        free = ids < 0
        born = np.flatnonzero(free & (detections.probability >= config.birth_probability))
        fresh = self._bear(born, detections)
        ids[born] = fresh.ids
        tracks = Tracks.concatenate([tracks, fresh])
        existence = tracks.existence
        sure = (existence >= config.confirm_existence) & (tracks.hits >= config.confirm_hits)
        confirmed = sure | (tracks.confirmed & (existence >= 0.5))
        tracks = tracks.with_columns(confirmed=confirmed)
        alive = existence >= DELETE_EXISTENCE
        alive &= detections.stamp_s - tracks.seen_s <= config.forget_after_s
        self.tracks = tracks.take(alive)
        return ids

    def _assign(self, detections: Detections) -> tuple[Ints, Ints]:
        """Rows of tracks and of detections that belong together."""
        tracks, config = self.tracks, self._config
        usable = np.flatnonzero(detections.probability >= config.probability_min)
        if not len(tracks) or not len(usable):
            return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
        offset = tracks.points_vehicle_m[:, None] - detections.points_vehicle_m[usable]
        spread = tracks.covariance_m2[:, None] + detections.covariance_m2[usable]
        x, y = offset[..., 0], offset[..., 1]
        xx, xy, yy = spread[..., 0, 0], spread[..., 0, 1], spread[..., 1, 1]
        determinant = xx * yy - xy * xy
        distance = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant
        width_error = tracks.width_m[:, None] - detections.width_m[usable]
        width_var = tracks.width_var_m2[:, None] + WIDTH_SD_M**2
        width_cost = np.where(
            np.isnan(width_error), 0.0, np.minimum(width_error**2 / width_var, 9.0)
        )
        log_det = np.log(determinant)
        cost = distance + 0.5 * width_cost + log_det - log_det.min()
        # an uncertain track must not snatch the detection of a sure one
        cost = cost - 0.5 * tracks.log_odds[:, None]
        cost = cost - cost.min() + 1.0
        allowed = (distance <= self._gate) & (np.hypot(x, y) <= GATE_MAX_M)
        allowed &= tracks.kind[:, None] == detections.kind[usable]
        # an empty column a track: it may go without
        square = np.full((len(tracks), len(usable) + len(tracks)), _FORBIDDEN)
        square[:, : len(usable)] = np.where(allowed, cost, _FORBIDDEN)
        square[:, len(usable) :] = np.where(np.eye(len(tracks), dtype=bool), 0.5 * _FORBIDDEN, 2e6)
        one, two = scipy.optimize.linear_sum_assignment(square)
        real = (two < len(usable)) & (square[one, two] < 0.5 * _FORBIDDEN)
        return one[real].astype(np.int64), usable[two[real]]

    def _correct(
        self, pairs: tuple[Ints, Ints], detections: Detections, dt: float, pace: float
    ) -> Tracks:
        tracks = self.tracks
        one, two = pairs
        r = np.exp(-max(dt, 1e-3) / ERROR_TIME_S)
        measured = detections.covariance_m2[two] * (1.0 + r) / (1.0 - r)
        prior = tracks.covariance_m2[one]
        # both are symmetric, so the transpose of the solution is the gain
        gain = np.swapaxes(np.linalg.solve(prior + measured, prior), 1, 2)
        innovation = detections.points_vehicle_m[two] - tracks.points_vehicle_m[one]
        keep = np.eye(2) - gain
        points = tracks.points_vehicle_m.copy()
        covariance = tracks.covariance_m2.copy()
        points[one] += np.einsum("nij,nj->ni", gain, innovation)
        covariance[one] = keep @ prior @ np.swapaxes(keep, 1, 2) + gain @ measured @ np.swapaxes(
            gain, 1, 2
        )
        shared = tracks.shift_per_px_m.copy()
        shared[one] += np.einsum("nij,nj->ni", gain, detections.shift_per_px_m[two] - shared[one])
        width, width_var = tracks.width_m.copy(), tracks.width_var_m2.copy()
        seen = detections.width_m[two]
        share = width_var[one] / (width_var[one] + WIDTH_SD_M**2)
        known = np.isfinite(seen)
        share = np.where(known, share, 0.0)
        width[one] += share * (np.where(known, seen, 0.0) - width[one])
        width_var[one] *= 1.0 - share
        width_var[one] = np.maximum(width_var[one], (0.3 * WIDTH_SD_M) ** 2)
        height = tracks.height_m.copy()
        tall = detections.height_m[two]
        part = 1.0 / np.minimum(tracks.hits[one] + 1.0, _HEIGHT_MEMORY)
        mixed = np.where(np.isnan(height[one]), tall, height[one] + part * (tall - height[one]))
        height[one] = np.where(np.isnan(tall), height[one], mixed)
        facing = tracks.facing_rad.copy()
        facing[one] += part * wrap_angle(detections.facing_rad[two] - facing[one])
        log_odds = tracks.log_odds.copy()
        log_odds[one] += pace * self._evidence(detections.probability[two])
        hits, seen_s = tracks.hits.copy(), tracks.seen_s.copy()
        hits[one] += 1
        seen_s[one] = detections.stamp_s
        detection = np.full(len(tracks), -1, dtype=np.int64)
        detection[one] = two
        return tracks.with_columns(
            points_vehicle_m=points,
            covariance_m2=covariance,
            width_m=width,
            width_var_m2=width_var,
            height_m=height,
            log_odds=np.clip(log_odds, -_LOG_ODDS_LIMIT, _LOG_ODDS_LIMIT),
            hits=hits,
            seen_s=seen_s,
            detection=detection,
            shift_per_px_m=shared,
            facing_rad=facing,
        )

    def _miss(self, tracks: Tracks, detections: Detections, pace: float) -> Tracks:
        """Less belief in what should have been seen and was not."""
        view = detections.view
        missed = tracks.detection < 0
        if view is not None:
            # stretched outward, so that a pole at the very end of the view is not expected
            away = (tracks.points_vehicle_m - view.origin_vehicle_m) / _LATE_SHARE
            missed &= view.contains(away + view.origin_vehicle_m)
        step = pace * np.log(1.0 - DETECTION_PROBABILITY)
        log_odds = np.maximum(tracks.log_odds + np.where(missed, step, 0.0), -_LOG_ODDS_LIMIT)
        return tracks.with_columns(log_odds=log_odds)

    def _evidence(self, probability: Floats) -> Floats:
        """Log of how much likelier such a look is at a pole than at another thing."""
        share = np.array(POLE_SHARE)
        return np.clip(_logit(probability) - _logit(share), *_HIT_LIMIT)

    def _bear(self, rows: Ints, detections: Detections) -> Tracks:
        count = len(rows)
        ids = np.arange(self._next_id, self._next_id + count, dtype=np.int64)
        self._next_id += count
        width = detections.width_m[rows]
        known = np.isfinite(width)
        stamps = np.full(count, detections.stamp_s)
        return Tracks(
            ids=ids,
            kind=detections.kind[rows],
            points_vehicle_m=detections.points_vehicle_m[rows],
            covariance_m2=detections.covariance_m2[rows],
            width_m=np.where(known, width, 0.2),
            width_var_m2=np.where(known, WIDTH_SD_M**2, 0.3**2),
            height_m=detections.height_m[rows],
            log_odds=self._evidence(detections.probability[rows]),
            hits=np.ones(count, dtype=np.int64),
            born_s=stamps,
            seen_s=stamps,
            confirmed=np.zeros(count, dtype=bool),
            detection=rows.astype(np.int64),
            shift_per_px_m=detections.shift_per_px_m[rows],
            facing_rad=detections.facing_rad[rows],
        )


def _logit(probability: Floats) -> Floats:
    p = np.clip(probability, 1e-4, 1.0 - 1e-4)
    return np.asarray(np.log(p / (1.0 - p)))
