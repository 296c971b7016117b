"""One motion as every sensor tells it: integrals that two stamps can be compared by."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from polemap.electric.estimators.base import Inputs
from polemap.vehicle.parameters import Car

TICK_S = 0.05
LONGEST_S = 8.0
# slower than this neither ay / v nor the tyres tell a yaw rate
SLOW_MPS = 3.0
# beyond this tyres are no matter of a linear bend, and side-slip may be anything of a slide
LIMIT_MPS2 = 4.5


class Moment(NamedTuple):
    """Integrals from the start up to `stamp_s`, and what is held there.

    Attributes:
        gyro, lateral, steering: heading turned (rad) by gyro, by ay / v, and by the bend of the
            steering.
        gyro_size, lateral_size, steering_size: the same of the absolute yaw rates.
        forward: speed gained by ax, with yaw rate times lateral speed of the steady bend, m/s.
        lane: turn of the lane, v kappa, rad.
        distance: of the trusted speed, m.
        wheel: wheel speed, m/s.
        gyro_square, lateral_square, steering_square: integrals of the squared yaw rates, rad^2/s.
        slow_s: stamp at which the car was last too slow to be judged.
        limit_s: stamp at which its tyres were last beyond what a car file tells of them.
    """

    stamp_s: float
    gyro: float = 0.0
    lateral: float = 0.0
    steering: float = 0.0
    gyro_size: float = 0.0
    lateral_size: float = 0.0
    steering_size: float = 0.0
    forward: float = 0.0
    lane: float = 0.0
    distance: float = 0.0
    wheel: float = 0.0
    gyro_square: float = 0.0
    lateral_square: float = 0.0
    steering_square: float = 0.0
    slow_s: float = float("-inf")
    limit_s: float = float("-inf")


class Motion:
    """Integrates inputs; `moments` are of the last `LONGEST_S`, one a tick.

    Attributes:
        now: the newest moment.
        yaw_rate_radps: of the steady bend that the steering asks for.
    """

    def __init__(self, car: Car, stamp_s: float) -> None:
        self._car = car
        front = 2.0 * (car.front_slip_stiffness_nprad or car.front_stiffness_nprad)
        rear = 2.0 * (car.rear_slip_stiffness_nprad or car.rear_stiffness_nprad)
        lf, lr = car.cg_to_front_m, car.cg_to_rear_m
        understeer = car.mass_kg * (lr * rear - lf * front) / (front * rear * car.wheelbase_m)
        # an oversteering car file may be a bad fit: its neutral bend errs by less
        self._understeer = max(understeer, 0.0)
        self._lag_per_mps = car.yaw_inertia_kgm2 / (lf * lf * front + lr * lr * rear)
        self.now = Moment(stamp_s, slow_s=stamp_s)
        self.moments: deque[Moment] = deque([self.now], maxlen=round(LONGEST_S / TICK_S) + 2)
        self.yaw_rate_radps = 0.0

    def carry(self, stamps_s: list[float], rows: list[Inputs], speed_mps: float) -> None:
        """Take in rows that end at `stamps_s`; `speed_mps` is the speed that is trusted."""
        if not rows:
            return
        last = self.now
        table = np.array(rows)
        span = stamps_s[-1] - last.stamp_s
        ends = np.array([last.stamp_s, *stamps_s])
        steps = ends[1:] - ends[:-1]
        speed = max(speed_mps, 1.0)
        steering, wheel, _, ax, ay, gyro, bend = (table.T @ steps).tolist()
        sizes = (np.abs(table[:, 4:6]).T @ steps).tolist()
        self._bend(span, steering / span, speed)
        rate = self.yaw_rate_radps
        middle = sorted((gyro / span, ay / (speed * span), rate))[1]
        slip = self._steady_slip(middle, speed)
        limit_s = stamps_s[-1] if abs(middle) * speed > LIMIT_MPS2 else last.limit_s
        self.now = Moment(
            stamps_s[-1],
            last.gyro + gyro,
            last.lateral + ay / speed,
            last.steering + rate * span,
            last.gyro_size + sizes[1],
            last.lateral_size + sizes[0] / speed,
            last.steering_size + abs(rate) * span,
            last.forward + ax + middle * slip * speed * span,
            last.lane + bend * speed_mps,
            last.distance + speed_mps * span,
            wheel / span,
            last.gyro_square + gyro * gyro / span,
            last.lateral_square + ay * ay / (speed * speed * span),
            last.steering_square + rate * rate * span,
            stamps_s[-1] if speed_mps < SLOW_MPS else last.slow_s,
            limit_s,
        )

    def tick(self) -> None:
        """Keep the moment of now for later comparison."""
        self.moments.append(self.now)

    def before(self, window_s: float) -> Moment | None:
        """The kept moment nearest to `window_s` ago; None where the record is shorter."""
        kept = self.moments
        place = len(kept) - 1 - round(window_s / TICK_S)
        if place < 0:
            return None
        wanted = kept[-1].stamp_s - window_s
        while place < len(kept) - 1 and kept[place].stamp_s < wanted - 0.5 * TICK_S:
            place += 1
        return kept[place]

    def _steady_slip(self, rate: float, speed: float) -> float:
        car = self._car
        return rate * (car.cg_to_rear_m / speed - car.rear_slip_rad_per_mps2 * speed)

    def _bend(self, t: float, steering: float, speed: float) -> None:
        """The steady bend of the linear tyres, reached with the time constant of the yaw rate."""
        wanted = speed * steering / (self._car.wheelbase_m + self._understeer * speed * speed)
        slow = max(speed * self._lag_per_mps, t)
        self.yaw_rate_radps += min(t / slow, 1.0) * (wanted - self.yaw_rate_radps)


def slow_between(start: Moment, end: Moment) -> bool:
    """Whether the car was too slow somewhere between, or hardly any time went by."""
    return end.slow_s >= start.stamp_s or end.stamp_s - start.stamp_s < 1e-3
