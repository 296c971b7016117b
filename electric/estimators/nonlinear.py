"""Beyond the papers: a single track on brush tyres that knows where its model and sensors end."""

from __future__ import annotations

from math import exp

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
    BANK,
    BETA,
    FORCE,
    GAMMA,
    GYRO_BIAS,
    LEAST_SLOPE,
    MOMENT,
    PSI,
    ROLL,
    SCALE,
    SIZE,
    STEERING,
    ProcessNoise,
    start_covariance,
)
from polemap.vehicle.axles import GRAVITY_MPS2, Axles
from polemap.vehicle.delay import ClonedFilter
from polemap.vehicle.parameters import Car
from polemap.vehicle.pose import wrap_angle
from polemap.vehicle.single_track import KINEMATIC_SPEED_MPS, lateral

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
        self._car, self._config, self._axles = car, config, Axles(car)
        self._limits = self._axles.limits(0.0)
        selection = np.zeros((1, SIZE))
        selection[0, BETA] = selection[0, PSI] = 1.0
        start = start_covariance()
        self._start_variance = start.diagonal().copy()
        self._filter = ClonedFilter(np.zeros(SIZE), start, selection, config.gps_slots)
        self._transition = np.eye(SIZE)
        self._noise, self._grade = ProcessNoise(car, config.heading_walk_rad), GradeKalman()
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
        self._limits = self._axles.limits(self._along)
        self._steering, self._speed = inputs.road_wheel_angle_rad, inputs.speed_mps
        self._noise.step(t, self._transition)
        x = self._filter.x
        across = x.item(GAMMA) * x.item(BETA) * self._speed
        self._grade.step(t, inputs.ax_mps2, across, self._speed)
        if self._speed >= KINEMATIC_SPEED_MPS:
            self._on_tyres(t, inputs.yaw_moment_nm)
        else:
            self._rolling(t)
        x[BETA] = min(max(x.item(BETA), -_SIDESLIP_MAX_RAD), _SIDESLIP_MAX_RAD)
        x[SCALE] = min(max(x.item(SCALE), -_SCALE_MAX), _SCALE_MAX)

    def _forces(self) -> tuple[float, float, float, float]:
        """Front force, slope, rear force, slope at the state, slopes at least `LEAST_SLOPE`."""
        x, limits = self._filter.x, self._limits
        front, front_slope, rear, rear_slope = self._axles.forces(
            x.item(BETA), x.item(GAMMA), self._steering - x.item(STEERING), self._speed, limits
        )
        scale = exp(x.item(SCALE))
        return (
            scale * front,
            scale * min(front_slope, -LEAST_SLOPE * limits[0]),
            scale * rear,
            scale * min(rear_slope, -LEAST_SLOPE * limits[2]),
        )

    def _on_tyres(self, t: float, moment_nm: float) -> None:
        f, car, v, g = self._filter, self._car, self._speed, self._transition
        x, m, inertia = f.x, car.mass_kg, car.yaw_inertia_kgm2
        lf, lr = car.cg_to_front_m, car.cg_to_rear_m
        front, front_slope, rear, rear_slope = self._forces()
        beta, gamma = x.item(BETA), x.item(GAMMA)
        force, turning = (front + rear) / (m * v), (lf * front - lr * rear) / inertia
        self._noise.on_tyres(abs(front) + abs(rear))
        lacking = x.item(FORCE) - GRAVITY_MPS2 * x.item(BANK)
        beta_rate = force + lacking / v - gamma - beta * self._along / v
        gamma_rate = turning + x.item(MOMENT) + moment_nm / inertia
        # A of the rates by beta and gamma; W = t (I - t/2 A)^-1; x+ = x + W f(x), G = I + W A
        moment_slope = (lf * front_slope - lr * rear_slope) / inertia
        a00 = (front_slope + rear_slope) / (m * v) - self._along / v
        a01 = moment_slope * inertia / (m * v * v) - 1.0
        a11 = (lf * lf * front_slope + lr * lr * rear_slope) / (inertia * v)
        h = 0.5 * t
        b00, b01, b10, b11 = 1.0 - h * a00, -h * a01, -h * moment_slope, 1.0 - h * a11
        inverse = t / (b00 * b11 - b01 * b10)
        w00, w01, w10, w11 = inverse * b11, -inverse * b01, -inverse * b10, inverse * b00
        steered, steered_turn = front_slope / (m * v), lf * front_slope / inertia
        g[0, 0], g[0, 1] = 1.0 + w00 * a00 + w01 * moment_slope, w00 * a01 + w01 * a11
        g[1, 0], g[1, 1] = w10 * a00 + w11 * moment_slope, 1.0 + w10 * a01 + w11 * a11
        g[0, FORCE], g[1, FORCE] = w00 / v, w10 / v
        g[0, BANK], g[1, BANK] = -GRAVITY_MPS2 * w00 / v, -GRAVITY_MPS2 * w10 / v
        g[0, MOMENT], g[1, MOMENT] = w01, w11
        g[0, SCALE], g[1, SCALE] = w00 * force + w01 * turning, w10 * force + w11 * turning
        g[0, STEERING] = w00 * steered + w01 * steered_turn
        g[1, STEERING] = w10 * steered + w11 * steered_turn
        self._predict(
            beta + w00 * beta_rate + w01 * gamma_rate,
            gamma + w10 * beta_rate + w11 * gamma_rate,
            x.item(PSI) + t * (gamma + 0.5 * (w10 * beta_rate + w11 * gamma_rate)),
        )

    def _rolling(self, t: float) -> None:
        """Too slow for tyres: side-slip and yaw rate relax to those of rolling without slip."""
        f, g = self._filter, self._transition
        a, b = lateral(self._car, max(self._speed, 0.0))
        steering = self._steering - f.x.item(STEERING)
        g[:2, FORCE:] = 0.0
        ends = []
        for index in (BETA, GAMMA):
            leak = exp(a[index, index] * t)
            answer = b[index, 0] / -a[index, index]
            g[index, :2] = 0.0
            g[index, index] = leak
            g[index, STEERING] = -(1.0 - leak) * answer
            ends.append(leak * f.x.item(index) + (1.0 - leak) * answer * steering)
            self._noise.rolling(index, answer * steering, leak)
        self._predict(ends[0], ends[1], f.x.item(PSI) + t * f.x.item(GAMMA))

    def _predict(self, beta: float, gamma: float, psi: float) -> None:
        f, g = self._filter, self._transition
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
        front, front_slope, rear, rear_slope = self._forces()
        car, m, v, row = self._car, self._car.mass_kg, self._speed, self._ay_row
        x = self._filter.x
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
