"""Beyond the papers: a single track on brush tyres that knows where its model and sensors end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import (
    GPS,
    LATERAL_ACCELERATION,
    YAW_RATE,
    Clock,
    Estimate,
    Inputs,
    OutputBridge,
    Value,
    fix_spread,
    pair,
)
from polemap.electric.estimators.grade import GradeKalman
from polemap.electric.estimators.process_noise import (
    AY_BIAS,
    BETA,
    FORCE,
    GAMMA,
    GYRO_BIAS,
    PSI,
    ROLL,
    SCALE,
    SIZE,
    STEERING,
    ProcessNoise,
    start_covariance,
)
from polemap.electric.estimators.single_track_motion import SingleTrackMotion
from polemap.vehicle.delay import ClonedFilter
from polemap.vehicle.parameters import Car
from polemap.vehicle.pose import wrap_angle
from polemap.vehicle.single_track import KINEMATIC_SPEED_MPS

Floats = NDArray[np.float64]

# noise of the accelerometer: measured from the changes between its values over this time, and never
# below a density that roll and vibration have at any rate
_NOISE_TIME_S, _NOISE_START_MPS2, _NOISE_DENSITY = 2.0, 1.5, 0.1
_AY_SPEED_MPS, _COURSE_SPEED_MPS = 3.0, 2.0
# beyond this many deviations a value is weighed down as if it stood there (Huber)
_OUTLIER_SD = 4.0
_SIDESLIP_MAX_RAD, _SCALE_MAX = 0.6, 0.7
_ALONG_TIME_S = 0.1


class NonlinearKalman:
    """Extended Kalman filter of a single track on brush tyres with load transfer.

    State `[beta, gamma, psi, d_y, d_z, b_y, kappa, delta_0, b_gamma, phi, rho]`: side-slip, yaw
    rate, heading; what the model lacks in lateral and yaw acceleration (leaky, so that the
    accelerometer moves the side-slip at once: beta' = (a_y - g phi) / v - gamma); bias of the
    accelerometer; logarithm of a common factor of all tyre forces; offsets of steering and gyro;
    bank of the road (the left side higher), and the body's roll as a share of what the
    accelerometer feels. The bank moves the car and is felt only as the tyres that hold it; it is
    told from the bias by how soon it changes and from the roll by the bends, and where neither
    tells them apart its deviation stays. The grade is estimated beside (`GradeKalman`).

    Measured: yaw rate gamma + b_gamma; lateral acceleration (1 + rho) (F_y / m + d_y) + b_y; course
    psi + beta of a GPS, exact for its delay by clones. Accelerometer and GPS are used where the
    log has them. Below `KINEMATIC_SPEED_MPS` the car rolls without slip as in `lateral`.

    Source: single track, brush tyres and ellipse as in Pacejka, Tyre and Vehicle Dynamics, 3rd
    ed., ch. 1 and 3; disturbance states as N13 (18), (19); step: linearly implicit midpoint rule.
    """

    fields = (
        "sideslip_rad",
        "yaw_rate_radps",
        "heading_rad",
        "force_disturbance_mps2",
        "moment_disturbance_radps2",
        "acceleration_bias_mps2",
        "tyre_force_log_scale",
        "steering_offset_rad",
        "gyro_bias_radps",
        "bank_rad",
        "roll_share",
        "grade_rad",
    )

    def __init__(self, car: Car, config: EstimatorConfig) -> None:
        self._car, self._config = car, config
        selection = np.zeros((1, SIZE))
        selection[0, BETA] = selection[0, PSI] = 1.0
        start = start_covariance()
        self._start_variance = start.diagonal().copy()
        self._filter = ClonedFilter(np.zeros(SIZE), start, selection, config.gps_slots)
        self._noise, self._grade = ProcessNoise(car, config.heading_walk_rad), GradeKalman()
        self._motion = SingleTrackMotion(car, self._noise)
        self._gyro_row, self._ay_row = np.zeros(self._filter.size), np.zeros(self._filter.size)
        self._gyro_row[GAMMA] = self._gyro_row[GYRO_BIAS] = 1.0
        self._ay_row[FORCE] = self._ay_row[AY_BIAS] = 1.0
        self._gyro_variance = config.gyro_sd_radps**2
        self._clock = Clock(config.step_s)
        self._bridge = OutputBridge(SIZE + 1)
        self._steering = self._along = 0.0
        self._speed = KINEMATIC_SPEED_MPS
        self._ay_last = float("nan")
        self._ay_variance = _NOISE_START_MPS2**2
        self._step_s = config.step_s
        self._headed = False
        self.dropped: dict[str, int] = {}

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        t = self._clock.advance(stamp_s)
        if not t:
            self._steering, self._speed = inputs.road_wheel_angle_rad, abs(inputs.speed_mps)
            return
        self._step_s = t
        self._along += (inputs.ax_mps2 - self._along) * min(1.0, t / _ALONG_TIME_S)
        self._motion.pushed(self._along)
        self._steering, self._speed = inputs.road_wheel_angle_rad, inputs.speed_mps
        self._noise.step(t, self._motion.transition)
        x = self._filter.x
        across = x.item(GAMMA) * x.item(BETA) * self._speed
        self._grade.step(t, inputs.ax_mps2, across, self._speed)
        motion = self._motion
        if self._speed >= KINEMATIC_SPEED_MPS:
            moved = motion.on_tyres(
                t, x, self._steering, self._speed, self._along, inputs.yaw_moment_nm
            )
        else:
            moved = motion.rolling(t, x, self._steering, self._speed)
        self._predict(*moved)
        x[BETA] = min(max(x.item(BETA), -_SIDESLIP_MAX_RAD), _SIDESLIP_MAX_RAD)
        x[SCALE] = min(max(x.item(SCALE), -_SCALE_MAX), _SCALE_MAX)

    def _predict(self, beta: float, gamma: float, psi: float) -> None:
        f, g = self._filter, self._motion.transition
        driven = -(g @ f.x[:SIZE])
        driven[BETA] += beta
        driven[GAMMA] += gamma
        driven[PSI] += psi
        driven[FORCE:] = 0.0
        f.predict(g, driven, self._noise.covariance)

    def capture(self, kind: str, stamp_s: float) -> None:
        if kind == GPS:
            # the course of the antenna: psi + beta + x gamma / v
            ahead = self._car.gps_point_m / max(self._speed, KINEMATIC_SPEED_MPS)
            self._filter.selection[0, GAMMA] = ahead
            self._filter.capture(stamp_s)

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        if kind == YAW_RATE:
            x = self._filter.x
            residual = float(value) - x.item(GAMMA) - x.item(GYRO_BIAS)  # type: ignore[arg-type]
            self._take(self._gyro_row, residual, self._gyro_variance, "gyro")
        elif kind == LATERAL_ACCELERATION:
            self._lateral(float(value))  # type: ignore[arg-type]
        elif kind == GPS:
            course, speed = pair(kind, value)
            slow = max(speed, _COURSE_SPEED_MPS)
            sd = max(self._config.course_sd_rad, self._config.speed_sd_mps / slow)
            sd, _ = fix_spread(value, sd, self._config.speed_sd_mps)
            self._course(course, speed, sd, stamp_s)

    def _lateral(self, ay_mps2: float) -> None:
        change, self._ay_last = ay_mps2 - self._ay_last, ay_mps2
        if change == change and change != 0.0:
            share = min(1.0, self._step_s / _NOISE_TIME_S)
            self._ay_variance += share * (0.5 * change * change - self._ay_variance)
        if self._speed < _AY_SPEED_MPS:
            return
        car, m, v, row = self._car, self._car.mass_kg, self._speed, self._ay_row
        x = self._filter.x
        front, front_slope, rear, rear_slope = self._motion.forces(x, self._steering, v)
        across = (front + rear) / m
        row[BETA] = (front_slope + rear_slope) / m
        row[GAMMA] = (car.cg_to_front_m * front_slope - car.cg_to_rear_m * rear_slope) / (m * v)
        felt = across + x.item(FORCE)
        row[SCALE], row[STEERING], row[ROLL] = across, front_slope / m, felt
        residual = ay_mps2 - (1.0 + x.item(ROLL)) * felt - x.item(AY_BIAS)
        least = _NOISE_DENSITY * _NOISE_DENSITY / self._step_s
        self._take(row, residual, max(self._ay_variance, least), "lateral acceleration")

    def _take(self, row: Floats, residual: float, variance: float, what: str) -> None:
        """One number, weighed down where it stands too far off."""
        if self._filter.row(row, residual, variance, _OUTLIER_SD):
            self._count(f"{what} beyond {_OUTLIER_SD:g} deviations, weighed down")

    def _course(self, course_rad: float, speed_mps: float, sd_rad: float, stamp_s: float) -> None:
        f = self._filter
        rows = f.clone(stamp_s)
        if rows is None:
            self._count("gps value without a capture")
            return
        if speed_mps >= _COURSE_SPEED_MPS:
            before = self._with_grade()
            residual = float(wrap_angle(course_rad - f.x.item(rows.start)))
            if not self._headed:
                # before the first course the heading is anything; later steps are small
                self._headed = True
                f.x[PSI] += residual
                f.x[SIZE:] += residual
                residual = 0.0
            row = np.zeros(f.size)
            row[rows.start] = 1.0
            self._take(row, residual, sd_rad * sd_rad, "gps course")
            self._bridge.corrected(self._clock.stamp_s, before, self._with_grade())
        f.release(stamp_s)

    def doubt(self) -> None:
        """What was learned of sensors, road and tyres may be a faulty sensor's: as open as ever."""
        for index in range(FORCE, SIZE):
            self._filter.p[index, index] += self._start_variance[index]

    def _count(self, reason: str) -> None:
        self.dropped[reason] = self.dropped.get(reason, 0) + 1

    def estimate(self) -> Estimate:
        return self._bridge.output(
            self._clock.stamp_s, self.fields, self._with_grade(), self.covariance()
        )

    def _with_grade(self) -> Floats:
        mean = np.empty(SIZE + 1)
        mean[:SIZE], mean[SIZE] = self._filter.x[:SIZE], self._grade.grade_rad
        return mean

    def covariance(self) -> Floats:
        covariance = np.zeros((SIZE + 1, SIZE + 1))
        covariance[:SIZE, :SIZE] = self._filter.p[:SIZE, :SIZE]
        covariance[SIZE, SIZE] = self._grade.variance
        return covariance
