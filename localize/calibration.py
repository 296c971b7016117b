"""Learning what the odometry gets wrong systematically: offsets and scales.

At standstill the yaw rate must be zero, so its mean is the gyroscope's offset. While driving, the
filter's own poses, which the poles hold, tell the turn and the way of a stretch; what the odometry
says differently over many stretches is an offset (of the gyroscope, or of the steering: a
curvature) or a scale.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.samples import OdometrySample
from polemap.localize.config import OdometryConfig
from polemap.localize.odometry_history import GAP_S, OdometryHistory
from polemap.vehicle.pose import rotate_back, wrap_angle

Floats = NDArray[np.float64]

_STRETCH_M = 20.0
_STRETCH_LONGEST_S = 15.0
_STRETCH_TURN_RAD = 0.8
_YAW_SPREAD_RADPS = 0.02
_GYRO_WHITE_RADPS = 0.005
# what is known of any car before it has driven: a steering offset of 0.25 degrees at a wheelbase of
# 2.7 m, a gyroscope good to 3 %
_CURVATURE_SD_RADPM, _YAW_RATE_SCALE_SD = 0.0015, 0.03
# wheel encoders of a standing car show nothing; a stop counts from its second second on
_STANDSTILL_MPS, _STANDSTILL_S = 0.03, 1.0
_FORGET_S = 3600.0  # offsets drift: what was learned returns to the prior in this time
_BOUND_SD = 3.0  # of the prior: more is no offset but a fault


@dataclass(frozen=True, slots=True)
class OdometryCorrection:
    """What was learned: yaw rate (1 + g) measured - b + c v, speed (1 + s) measured.

    Attributes:
        yaw_rate_offset_radps: b.
        curvature_radpm: c, what a steering offset does.
        yaw_rate_scale: g.
        speed_scale: s.
    """

    yaw_rate_offset_radps: float = 0.0
    curvature_radpm: float = 0.0
    yaw_rate_scale: float = 0.0
    speed_scale: float = 0.0

    def rates(self, sample: OdometrySample) -> tuple[float, float]:
        """Corrected speed and yaw rate."""
        turning = (1.0 + self.yaw_rate_scale) * sample.yaw_rate_radps - self.yaw_rate_offset_radps
        return (
            (1.0 + self.speed_scale) * sample.speed_mps,
            turning + self.curvature_radpm * sample.speed_mps,
        )


@dataclass(frozen=True, slots=True)
class _Start:
    """A pose of the filter, and what raw odometry had added up to at its stamp."""

    stamp_s: float
    pose: Floats
    variance_m2: float
    variance_rad2: float
    odometry_pose: Floats
    travelled_m: float
    turn_only: bool = False


@dataclass(frozen=True, slots=True)
class _Stretch:
    """What raw odometry makes of the way between two poses of the filter.

    Attributes:
        distance_m: along the path, negative backward.
        chord_m: between the ends.
    """

    time_s: float
    distance_m: float
    turn_rad: float
    chord_m: float


class OdometryCalibration:
    """Two small Kalman filters: (offset, curvature, scale) of the yaw rate, scale of the speed."""

    def __init__(self, config: OdometryConfig) -> None:
        self._config = config
        self._yaw = np.zeros(3)
        self._yaw_prior = np.diag(
            np.array(
                [
                    config.yaw_rate_offset_sd_radps,
                    _CURVATURE_SD_RADPM,
                    _YAW_RATE_SCALE_SD,
                ]
            )
            ** 2
        )
        self._yaw_cov = self._yaw_prior.copy()
        self._scale: float = 0.0
        self._scale_var = config.speed_scale_sd**2
        self._still: deque[OdometrySample] = deque()
        self._raw = OdometryHistory()
        self._start: _Start | None = None

    @property
    def correction(self) -> OdometryCorrection:
        """What has been learned so far."""
        offset, curvature, scale = self._yaw.tolist()
        return OdometryCorrection(offset, curvature, scale, self._scale)

    def uncertainty(self, speed_mps: float, yaw_rate_radps: float) -> tuple[float, float]:
        """Standard deviations of the speed's scale and of the yaw rate, rad/s, at these rates."""
        row = np.array([-1.0, speed_mps, yaw_rate_radps])
        return float(np.sqrt(self._scale_var)), float(np.sqrt(row @ self._yaw_cov @ row))

    def correct(self, sample: OdometrySample) -> OdometrySample:
        """The sample without what has been learned; also feeds the standstill detector."""
        if not self._config.learn_offsets:
            return sample
        self._watch_standstill(sample)
        speed, yaw_rate = self.correction.rates(sample)
        if self._standing():
            # no turn without motion; what is left of the offset must not turn a standing car
            speed = yaw_rate = 0.0
        if len(self._raw) and sample.stamp_s - self._raw.newest_s > GAP_S:
            self._start = None
        self._raw.append(sample)
        return OdometrySample(sample.stamp_s, sample.arrival_s, speed, yaw_rate)

    def distrust(self) -> None:
        """Odometry is contradicted: neither a standstill nor a stretch of it teaches anything."""
        self._still.clear()
        self._start = None

    def forget(self) -> None:
        """A restart starts clean: what was learned at a wrong place is wrong."""
        self._yaw, self._yaw_cov = np.zeros(3), self._yaw_prior.copy()
        self._scale, self._scale_var = 0.0, self._config.speed_scale_sd**2
        self.distrust()

    def _watch_standstill(self, sample: OdometrySample) -> None:
        """Keep the unbroken run of samples without speed, at most one window long."""
        if abs(sample.speed_mps) > _STANDSTILL_MPS:
            self._still.clear()
            return
        self._still.append(sample)
        span = sample.stamp_s - self._still[0].stamp_s
        if span < 2.0 * _STANDSTILL_S:
            return
        # the first half may still hold the nodding of the stop: the second half counts, once
        half = self._still[0].stamp_s + _STANDSTILL_S
        rates = np.array([s.yaw_rate_radps for s in self._still if s.stamp_s > half])
        self._still.clear()
        self._still.append(sample)
        spread = float(np.median(np.abs(rates - np.median(rates))))
        if spread > _YAW_SPREAD_RADPS or abs(np.median(rates)) > 5 * self._offset_limit():
            return  # it turns without wheels: a ferry, a turntable, a broken speed signal
        noise = _GYRO_WHITE_RADPS**2 / len(rates)
        self._update_yaw(np.array([1.0, 0.0, 0.0]), float(rates.mean()), noise)

    def _offset_limit(self) -> float:
        return max(self._config.yaw_rate_offset_sd_radps, 1e-3)

    def _standing(self) -> bool:
        still = self._still
        return len(still) > 1 and still[-1].stamp_s - still[0].stamp_s >= 0.5

    def _update_yaw(self, row: Floats, value: float, variance: float) -> None:
        gain = self._yaw_cov @ row / (row @ self._yaw_cov @ row + variance)
        self._yaw = self._yaw + gain * (value - row @ self._yaw)
        keep = np.eye(3) - np.outer(gain, row)
        self._yaw_cov = keep @ self._yaw_cov @ keep.T + np.outer(gain, gain) * variance

    def interrupt(self) -> None:
        """The pose is not trusted: no stretch runs over it."""
        self._start = None

    def learn_from_pose(
        self, stamp_s: float, pose: Floats, covariance: Floats, *, turn_only: bool = False
    ) -> None:
        """Offer a rear-axle pose that poles hold; a stretch ends at it when it is long enough.

        Args:
            turn_only: lines hold it, which say nothing of the way.
        """
        if not (self._config.learn_offsets and self._config.learn_from_poses):
            return
        start, travelled_m = self._start, self._raw.travelled_m(stamp_s)
        long_enough = start is not None and travelled_m - start.travelled_m >= _STRETCH_M
        if start is not None and not long_enough and stamp_s - start.stamp_s < _STRETCH_LONGEST_S:
            return
        end = _Start(
            stamp_s,
            pose.copy(),
            0.5 * float(covariance[0, 0] + covariance[1, 1]) + 0.12**2,
            float(covariance[2, 2]) + 0.004**2,
            # of the pose's own moment: odometry of the scan's delay is there already, and a car
            # that changes its speed drives another way in the delay of either end
            self._raw.odometry_pose(stamp_s),
            travelled_m,
            turn_only,
        )
        if start is not None and long_enough:
            self._use(start, end)
        self._start = end

    def _use(self, start: _Start, end: _Start) -> None:
        stretch = _stretch_between(start, end)
        self._return_to_prior(stretch.time_s)
        turned = float(wrap_angle(end.pose[2] - start.pose[2]))
        error = float(wrap_angle(turned - stretch.turn_rad))
        row = np.array([-stretch.time_s, stretch.distance_m, stretch.turn_rad])
        noise = start.variance_rad2 + end.variance_rad2 + (0.05 * stretch.turn_rad) ** 2
        noise += 0.002**2 * stretch.time_s
        expected = float(row @ self._yaw)
        spread = float(row @ self._yaw_cov @ row) + noise
        if (error - expected) ** 2 < 16.0 * spread:
            self._update_yaw(row, error, noise)
        along = not (start.turn_only or end.turn_only)
        if along and abs(stretch.turn_rad) < _STRETCH_TURN_RAD:
            # the length of the chord does not depend on the heading
            way = float(np.hypot(*(end.pose[:2] - start.pose[:2])))
            self._update_scale(way, stretch.chord_m, start.variance_m2 + end.variance_m2)

    def _return_to_prior(self, time_s: float) -> None:
        """Gauss-Markov: bounded by the prior, and able to move back from what was learned."""
        keep = float(np.exp(-time_s / _FORGET_S))
        bound = _BOUND_SD * np.sqrt(np.diag(self._yaw_prior))
        self._yaw = np.clip(keep * self._yaw, -bound, bound)
        self._yaw_cov = keep**2 * self._yaw_cov + (1.0 - keep**2) * self._yaw_prior
        prior = self._config.speed_scale_sd**2
        limit = _BOUND_SD * float(np.sqrt(prior))
        self._scale = float(np.clip(keep * self._scale, -limit, limit))
        self._scale_var = keep**2 * self._scale_var + (1.0 - keep**2) * prior

    def _update_scale(self, way_m: float, chord_m: float, variance_m2: float) -> None:
        noise = variance_m2 + (0.01 * chord_m) ** 2
        innovation = way_m - (1.0 + self._scale) * chord_m
        spread = chord_m**2 * self._scale_var + noise
        if innovation**2 < 16.0 * spread:
            gain = self._scale_var * chord_m / spread
            self._scale += float(gain * innovation)
            self._scale_var *= float(1.0 - gain * chord_m)


def _stretch_between(start: _Start, end: _Start) -> _Stretch:
    moved = end.odometry_pose - start.odometry_pose
    ahead = float(rotate_back(moved[:2], start.odometry_pose[2])[0])
    return _Stretch(
        end.stamp_s - start.stamp_s,
        float(np.copysign(end.travelled_m - start.travelled_m, ahead)),
        float(moved[2]),
        float(np.hypot(moved[0], moved[1])),
    )
