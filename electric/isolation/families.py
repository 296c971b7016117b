"""The two families of votes: yaw rate and speed, with what each sensor may err by.

Tolerances are bounds of what good sensors of a road car do, bank to 4 degrees, roll to 6 degrees
at 1 g and slopes to 13 % in them, not of their noise.
"""

from __future__ import annotations

from math import log

from polemap.electric.config import EstimatorConfig
from polemap.electric.isolation.alone import (
    FORWARD,
    GYRO,
    LATERAL,
    STEERING,
    WHEEL_SPEED,
)
from polemap.electric.isolation.late import Event
from polemap.electric.isolation.motion import Moment
from polemap.electric.isolation.votes import Vote
from polemap.vehicle.parameters import Car

GPS, CAMERA = "GPS", "camera"
WINDOWS_S = (0.5, 2.0, 8.0)
"""Steps and stuck values show in the first, scales in the second, drifts in the last."""

_GYRO_RADPS, _GYRO_SHARE = 0.015, 0.04
_LATERAL_MPS2, _LATERAL_SHARE = 0.8, 0.12
# side-slip within a window: at rest, and with lateral acceleration
_SLIP_RAD, _SLIP_RAD_PER_MPS2, _SLIP_MOST_RAD = 0.012, 0.006, 0.08
_SLIDE_RAD = 0.2
_STEERING_RAD, _STEERING_SHARE = 0.006, 0.25
_LANE_PER_M, _LANE_SHARE = 0.001, 0.2
_SLOPE_MPS2, _WHEEL_MPS, _WHEEL_SHARE = 1.4, 0.4, 0.03
_SPEED_MPS, _SPEED_SHARE = 1.0, 0.07
_EXCITED_RADPS, _BANK_MPS2 = 0.06, 0.5


class Families:
    """Votes about the motion between two moments.

    Args:
        heard: names of the sensors that have spoken; grows.
    """

    def __init__(self, car: Car, config: EstimatorConfig, heard: set[str]) -> None:
        self._car, self._config, self._heard = car, config, heard

    def level(self, start: Moment, end: Moment) -> float:
        """Mean absolute yaw rate, the middle one of three sensors', rad/s."""
        sizes = [end.gyro_size - start.gyro_size, end.steering_size - start.steering_size]
        if LATERAL in self._heard:
            sizes.append(end.lateral_size - start.lateral_size)
        return sorted(sizes)[len(sizes) // 2] / (end.stamp_s - start.stamp_s)

    def yaw(
        self, start: Moment, end: Moment, gps: tuple[Event, Event] | None = None,
        camera: tuple[Event, Event] | None = None,
    ) -> dict[str, Vote]:  # fmt: skip
        """Mean yaw rates between two moments; of GPS or camera between two events there."""
        t, heard = end.stamp_s - start.stamp_s, self._heard
        v = max((end.distance - start.distance) / t, 1.0)
        level = self.level(start, end)
        lateral = level * v
        slip = _SLIP_RAD + _SLIP_RAD_PER_MPS2 * lateral
        if end.limit_s >= start.stamp_s:
            slip = _SLIDE_RAD
        votes = {}
        if GYRO in heard:
            votes[GYRO] = Vote((end.gyro - start.gyro) / t, _GYRO_RADPS + _GYRO_SHARE * level)
        if LATERAL in heard:
            error = (_LATERAL_MPS2 + _LATERAL_SHARE * lateral) / v + slip / t
            votes[LATERAL] = Vote((end.lateral - start.lateral) / t, error)
        if STEERING in heard and end.limit_s < start.stamp_s:
            gain = v / (self._car.wheelbase_m + max(self._car.understeer_s2pm, 0.0) * v * v)
            error = _STEERING_RAD * gain + _STEERING_SHARE * level + slip / t
            votes[STEERING] = Vote((end.steering - start.steering) / t, error)
        if gps is not None:
            stated = max(gps[0].sd_rad, gps[1].sd_rad)
            sd = max(self._config.course_sd_rad, self._config.speed_sd_mps / v, stated)
            change = gps[1].angle_rad - gps[0].angle_rad
            votes[GPS] = Vote(change / t, (6.0 * sd + slip) / t)
        if camera is not None:
            lane = (end.lane - start.lane) / t
            change = camera[1].angle_rad - camera[0].angle_rad
            error = 6.0 * self._config.heading_sd_rad + 0.01
            error = error / t + v * _LANE_PER_M + _LANE_SHARE * abs(lane)
            votes[CAMERA] = Vote(change / t + lane, error)
        return votes

    def gain(self, start: Moment, end: Moment) -> dict[str, Vote]:
        """Logarithm of the root mean square yaw rate about its mean; none where nothing turns."""
        t = end.stamp_s - start.stamp_s
        # bank moves ay / v by so much
        bank = _BANK_MPS2 * t / max(end.distance - start.distance, 1.0)
        votes: dict[str, Vote] = {}
        if end.limit_s >= start.stamp_s:
            return votes
        for name, turned, square, share, error in (
            (GYRO, end.gyro - start.gyro, end.gyro_square - start.gyro_square, 0.04, 0.0),
            (LATERAL, end.lateral - start.lateral, end.lateral_square - start.lateral_square,
             0.12, bank),
            (STEERING, end.steering - start.steering, end.steering_square - start.steering_square,
             0.2, 0.0),
        ):  # fmt: skip
            variance = square / t - (turned / t) ** 2
            if name in self._heard and variance > _EXCITED_RADPS**2:
                tolerance = share + 0.5 * log(1.0 + error * error / variance)
                votes[name] = Vote(0.5 * log(variance), tolerance)
        return votes if len(votes) > 1 else {}

    def across(self, first: Event, last: Event, faulty: set[str]) -> bool:
        """Whether a camera's offset moved as its heading says, within what side-slip may add."""
        start, end = first.moment, last.moment
        t, gone = end.stamp_s - start.stamp_s, end.distance - start.distance
        lateral = self.level(start, end) * gone / t
        moved = last.other - first.other
        # y' = v (psi + beta) + l gamma; side-slip of the steady bend, the turn of the middle sensor
        told = {
            GYRO: end.gyro - start.gyro,
            STEERING: end.steering - start.steering,
            LATERAL: end.lateral - start.lateral,
        }
        turns = sorted(told[n] for n in told if n in self._heard and n not in faulty)
        if not turns:
            return True
        turn, speed = turns[len(turns) // 2], gone / t
        car = self._car
        arm = car.preview_m + car.cg_to_rear_m - car.rear_slip_rad_per_mps2 * speed * speed
        wanted = last.way - first.way + arm * turn
        error = 8.0 * self._config.lateral_offset_sd_m + 0.1
        error += gone * (0.025 + _SLIP_RAD_PER_MPS2 * lateral + 2.0 * self._config.heading_sd_rad)
        error += 0.1 * self._car.preview_m * self.level(start, end) * t
        # a turn that the others tell differently is known no better than that
        error += 0.5 * abs(arm) * (turns[-1] - turns[0])
        return abs(moved - wanted) <= error

    def speed(
        self, start: Moment, end: Moment, gps: tuple[Event, Event] | None = None
    ) -> dict[str, Vote]:
        """Change of speed between two moments, m/s."""
        t = end.stamp_s - start.stamp_s
        votes = {}
        if WHEEL_SPEED in self._heard:
            error = _WHEEL_MPS + _WHEEL_SHARE * abs(end.distance - start.distance) / t
            votes[WHEEL_SPEED] = Vote(end.wheel - start.wheel, error)
        if FORWARD in self._heard:
            lateral = self.level(start, end) * abs(end.distance - start.distance) / t
            error = (_SLOPE_MPS2 + _SLIP_MOST_RAD * lateral) * t + 0.3
            votes[FORWARD] = Vote(end.forward - start.forward, error)
        if gps is not None:
            votes[GPS] = Vote(gps[1].other - gps[0].other, 8.0 * self._config.speed_sd_mps + 0.1)
        return votes

    def same_speed(self, event: Event) -> bool:
        """Whether a GPS speed is that of the wheels at its capture."""
        wheel = event.moment.wheel
        return abs(event.other - wheel) <= _SPEED_MPS + _SPEED_SHARE * abs(wheel)
