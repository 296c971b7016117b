"""Which way the car goes in the eyes of the camera that its poles are seen with."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np

from polemap.drivelog.samples import OdometrySample

# so much of the way is kept, and needed for a word
_KEPT_M, _LEAST_M, _LEAST_STEPS = 90.0, 5.0, 5
# a step says something while the car rolls, on no tighter bend than this, 1/m, and no more than
# one of so many metres: before it others were missing
_ROLLING_MPS, _BEND_MAX_RADPM, _STEP_MAX_M = 1.0, 0.03, 2.0
# sd of a step's direction, rad; way over which such errors stay alike; what is left after any way
# (the principal point of a rectified pair, a camera that pitches)
_STEP_RAD, _ALIKE_M, _FLOOR_RAD = 0.003, 4.0, 0.0017
# in a bend: the rear axle's place below the camera, m, and its outward slip are known so well
_AXLE_SD_M = 0.5


class DetectorCourse:
    """Side-slip of the rear axle as the camera sees it that the poles are seen with.

    A camera whose mounting has turned sees a car that drives straight on go aside by that turn. So
    the direction of its own motion tells the turn without a map, of every metre that is driven; as
    the poles against the odometry's path do, it takes a car that really goes aside of its heading
    for a turn.

    Args:
        slip_rad_per_mps2: the rear axle slips outward by this angle per lateral acceleration.
    """

    def __init__(self, slip_rad_per_mps2: float) -> None:
        self._slip_rad_per_mps2 = slip_rad_per_mps2
        self._travelled_m = 0.0
        self._ways_m: list[float] = []
        self._steps: list[tuple[float, float, float]] = []  # length, direction, curvature

    def add_step(self, odometry: OdometrySample, travelled_m: float) -> None:
        """Take in a motion of the camera.

        Args:
            odometry: with what it says of the speed aside.
            travelled_m: way until then.
        """
        moved_m, self._travelled_m = travelled_m - self._travelled_m, travelled_m
        moved_m = min(moved_m, _STEP_MAX_M)
        speed, yaw_rate = odometry.speed_mps, odometry.yaw_rate_radps
        if speed < _ROLLING_MPS or abs(yaw_rate) > _BEND_MAX_RADPM * speed or moved_m <= 0.0:
            return
        slip = odometry.lateral_mps / speed + self._slip_rad_per_mps2 * speed * yaw_rate
        self._ways_m.append(travelled_m)
        self._steps.append((moved_m, slip, abs(yaw_rate) / speed))
        if travelled_m - self._ways_m[0] > 2.0 * _KEPT_M:
            old = bisect_left(self._ways_m, travelled_m - _KEPT_M)
            del self._ways_m[:old], self._steps[:old]

    def turn(self, from_m: float, until_m: float = np.inf) -> tuple[float, float] | None:
        """Turn of what is seen, counter-clockwise, and its standard deviation, rad.

        Args:
            from_m, until_m: the part of the way that is asked for.

        Returns:
            None where too little of it was straight.
        """
        first, last = bisect_left(self._ways_m, from_m), bisect_left(self._ways_m, until_m)
        if last - first < _LEAST_STEPS:
            return None
        length, slip, bend = np.array(self._steps[first:last]).T
        way_m = float(length.sum())
        if way_m < _LEAST_M:
            return None
        axle = _AXLE_SD_M * bend
        weight = length / (_STEP_RAD**2 + axle**2)
        weight /= weight.sum()
        mean = float(weight @ slip)
        scatter = max(_STEP_RAD, float(np.sqrt(weight @ (slip - mean) ** 2)))
        alone = float((weight**2 / length).sum()) * _ALIKE_M
        # the axle errs alike in a whole bend
        variance = _FLOOR_RAD**2 + float(weight @ axle) ** 2 + scatter**2 * min(1.0, alone)
        return mean, float(np.sqrt(variance))
