"""Inter-sample residual compensation with scheduled steady gains: smooth, and a few microseconds.

All that a step needs lies in a table over speed, computed once: the discrete model and the gain
of the Riccati equation with all outputs at every step and the camera's variance times the number
of steps in a frame. The step is plain arithmetic on numbers; the nearest of `ROWS` speeds serves.
"""

from __future__ import annotations

from functools import lru_cache
from math import log

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import (
    CAMERA,
    YAW_RATE,
    Clock,
    Estimate,
    Inputs,
    OutputBridge,
    Value,
)
from polemap.electric.estimators.base import pair as two_numbers
from polemap.electric.estimators.gate import Gate
from polemap.electric.estimators.vision import ALL_ROWS, initial_covariance, vision_density
from polemap.vehicle.kalman import symmetric
from polemap.vehicle.parameters import Car
from polemap.vehicle.single_track import (
    KINEMATIC_SPEED_MPS,
    bend_of_lane,
    combined_vision,
    schedule,
)

Floats = NDArray[np.float64]
ROWS, GAIN_ROWS, LOWEST_MPS, HIGHEST_MPS = 2048, 96, KINEMATIC_SPEED_MPS, 80.0
PSEUDO_INVERSE = ALL_ROWS.T  # C'(C C')^-1 of a C whose rows are unit vectors


def steady_gain(
    transition: Floats, noise: Floats, config: EstimatorConfig
) -> tuple[Floats, Floats]:
    """Gain `(4, 3)` and covariance `(4, 4)` after the update of the steady filter with all rows."""
    frames = max(1.0, round(config.camera_period_s / config.step_s))
    r = np.diag(
        [
            config.gyro_sd_radps**2,
            frames * config.heading_sd_rad**2,
            frames * config.lateral_offset_sd_m**2,
        ]
    )
    prior = scipy.linalg.solve_discrete_are(transition.T, ALL_ROWS.T, noise, r)
    gain = np.linalg.solve(ALL_ROWS @ prior @ ALL_ROWS.T + r, ALL_ROWS @ prior).T
    return gain, symmetric((np.eye(4) - gain @ ALL_ROWS) @ prior)


@lru_cache(maxsize=8)
def _table(car: Car, config: EstimatorConfig) -> tuple[list[tuple[float, ...]], Floats, float]:
    """Rows of plain numbers (G 9, H 8, K 12), covariances at them, and rows per log speed."""
    model = schedule(combined_vision, car, vision_density(config), config.step_s)
    coarse = np.linspace(log(LOWEST_MPS), log(HIGHEST_MPS), GAIN_ROWS)
    gains, covariances = [], []
    for position in coarse:
        g, _, q = model.exact(float(np.exp(position)))
        # the geometry is noise-free; a whisper keeps the Riccati equation's solution unique
        gain, covariance = steady_gain(g, q + np.diag([0.0, 0.0, 1e-14, 1e-14]), config)
        gains.append(gain.ravel())
        covariances.append(covariance.ravel())
    fine = np.linspace(log(LOWEST_MPS), log(HIGHEST_MPS), ROWS)

    def spread(rows: list[Floats]) -> Floats:
        return np.column_stack([np.interp(fine, coarse, column) for column in np.array(rows).T])

    gain_rows, rows = spread(gains), []
    for position, gain_row in zip(fine, gain_rows, strict=True):
        g, h, _ = model.at(float(np.exp(position)))
        numbers = [*g[0, :2], *g[1, :2], *g[2, :2], *g[3, :3], *h[:, 0], *h[:, 1], *gain_row]
        rows.append(tuple(float(v) for v in numbers))
    return rows, spread(covariances), (ROWS - 1) / log(HIGHEST_MPS / LOWEST_MPS)


class CompensatedKalman:
    """State `[beta, gamma, psi, y_l]`; between pictures the residual is propagated, not zero.

    At an arrival `eps = y - C x_s` against the state stored at the capture (after an arrival of
    that step), `e = (C+ - K) eps`; at each step after it `e~ = G e`, the residual of heading and
    offset is `C e~`, and `e = (I - K C) e~`. The yaw rate's residual is always the real one.

    The reported deviation is that of the steady filter at the speed of now; it ignores the
    delay. When pictures stay away it grows as the gyro alone lets it. The first picture after that
    sets heading and offset, and the states stored meanwhile with them: a residual of metres is none
    to propagate, since a second picture would find it in its stored state and correct it again.

    The residual is propagated for j < T_l / T_s steps (W14), or `until_arrival` of the next
    picture, whenever that is (W13, whose pictures come unevenly).

    Source: W14 (17)-(22), W13 (16)-(22) as corrected in errata.md, Inter-sample compensation.
    """

    fields = ("sideslip_rad", "yaw_rate_radps", "heading_rad", "lateral_offset_m")

    def __init__(self, car: Car, config: EstimatorConfig, *, until_arrival: bool = False) -> None:
        self._config = config
        frame = max(1, round(config.camera_period_s / config.step_s))
        self._propagated_steps = 1 << 62 if until_arrival else frame - 1
        self._left = 0
        self._rows, self._covariances, self._per_log = _table(car, config)
        self._schedule = schedule(combined_vision, car, vision_density(config), config.step_s)
        self._clock = Clock(config.step_s)
        self._bridge = OutputBridge(4)
        self._b = self._r = self._h = self._y = 0.0
        self._eb = self._er = self._eh = self._ey = 0.0
        self._row = self._rows[0]
        self._index = 0
        self._inputs = Inputs(0.0, LOWEST_MPS)
        self._stored: list[tuple[float, float, float]] = []
        self._heard_s = float("nan")
        # grows in an outage and at the start; None while the steady filter's holds
        self._loose: Floats | None = initial_covariance(config)
        self._residual = 0.0
        self.dropped: dict[str, int] = {}
        self.gate = Gate(config, self.dropped)

    def step(self, stamp_s: float, inputs: Inputs) -> None:
        elapsed = self._clock.advance(stamp_s)
        if elapsed == 0.0:
            self._heard_s = stamp_s
            return
        speed = inputs.speed_mps
        index = int(log(speed) * self._per_log + 0.5) if speed > LOWEST_MPS else 0
        self._index = index = index if index < ROWS else ROWS - 1
        row = self._rows[index]
        if elapsed != self._config.step_s or speed < LOWEST_MPS:
            row = self._exact(inputs, elapsed, row)
        if self._loose is not None:
            row = (*row[:17], *self._loosen(self._loose, stamp_s))
        self._row, self._inputs = row, inputs
        (g00, g01, g10, g11, g20, g21, g30, g31, g32, d0, d1, d2, d3, n0, n1, n2, n3) = row[:17]
        (_, k01, k02, _, k11, k12, _, k21, k22, _, k31, k32) = row[17:]
        delta, moment = inputs.road_wheel_angle_rad, inputs.yaw_moment_nm
        b, r, h = self._b, self._r, self._h
        if self._left <= 0:
            self._eb = self._er = self._eh = self._ey = 0.0
        self._left -= 1
        eb, er, eh = self._eb, self._er, self._eh
        e0, e1 = g00 * eb + g01 * er, g10 * eb + g11 * er
        e2 = g20 * eb + g21 * er + eh
        e3 = g30 * eb + g31 * er + g32 * eh + self._ey
        # heading and offset are corrected by the propagated residuals e2, e3
        self._y += g30 * b + g31 * r + g32 * h + d3 * delta + n3 * moment + k31 * e2 + k32 * e3
        self._h = h + g20 * b + g21 * r + d2 * delta + n2 * moment + k21 * e2 + k22 * e3
        if inputs.road_curvature_per_m:
            turned, moved = bend_of_lane(speed, inputs.road_curvature_per_m, elapsed)
            self._h += turned
            self._y += moved
        self._b = g00 * b + g01 * r + d0 * delta + n0 * moment + k01 * e2 + k02 * e3
        self._residual = g10 * b + g11 * r + d1 * delta + n1 * moment
        self._r = self._residual + k11 * e2 + k12 * e3
        # e = (I - K C) e~, the yaw rate's column included
        k00, k10, k20, k30 = row[17], row[20], row[23], row[26]
        self._eb = e0 - k00 * e1 - k01 * e2 - k02 * e3
        self._er = e1 - k10 * e1 - k11 * e2 - k12 * e3
        self._eh = e2 - k20 * e1 - k21 * e2 - k22 * e3
        self._ey = e3 - k30 * e1 - k31 * e2 - k32 * e3
        if self._loose is None and self._silent(stamp_s):
            self._loose = self.covariance()

    def _silent(self, stamp_s: float) -> bool:
        """Whether pictures stay away."""
        return stamp_s - self._heard_s > 3.0 * self._config.camera_period_s

    def measure(self, kind: str, value: Value, stamp_s: float, arrival_s: float) -> None:
        if kind == YAW_RATE:
            row = self._row
            # against the prediction before the pseudo correction of this step: one joint update
            residual = float(value) - self._residual  # type: ignore[arg-type]
            config, scale = self._config, self.gate.noise_scale.get(YAW_RATE)
            variance = config.gyro_sd_radps**2 / max(1.0 - row[20], 1e-6)
            if self.gate.refuses(YAW_RATE, stamp_s, (residual, variance)):
                return
            if scale is not None:
                # a steady gain is nearly as one over the noise's variance
                residual /= scale * scale
            self._b += row[17] * residual
            self._r += row[20] * residual
            self._h += row[23] * residual
            self._y += row[26] * residual
        elif kind == CAMERA:
            heading, offset = two_numbers(kind, value)
            found = [s for s in self._stored if abs(s[0] - stamp_s) < 1e-6]
            if not found:
                self.dropped["camera value without a capture"] = (
                    self.dropped.get("camera value without a capture", 0) + 1
                )
                return
            self._stored = [s for s in self._stored if s is not found[0]]
            residuals = heading - found[0][1], offset - found[0][2]
            config = self._config
            sds = config.heading_sd_rad, config.lateral_offset_sd_m
            p = self.covariance()
            numbers = [
                (residual, float(p[k, k]) + sd * sd)
                for k, residual, sd in zip((2, 3), residuals, sds, strict=True)
            ]
            if self.gate.refuses(CAMERA, stamp_s, *numbers):
                return
            if self._loose is not None and self._silent(self._clock.stamp_s):
                self._begin_anew(stamp_s, *residuals)
            else:
                self._arrive(*residuals)

    def _begin_anew(self, captured_s: float, heading: float, offset: float) -> None:
        """Take heading and offset from the first picture after an outage."""
        config, before, now = self._config, self._state(), self._clock.stamp_s
        speed = self._inputs.speed_mps

        def moved(stamp_s: float) -> float:
            return offset + speed * (stamp_s - captured_s) * heading

        self._h += heading
        self._y += moved(now)
        self._stored = [(s, h + heading, y + moved(s)) for s, h, y in self._stored]
        self._eb = self._er = self._eh = self._ey = 0.0
        self._left = 0
        loose = self.covariance()
        loose[2:] = loose[:, 2:] = 0.0
        aside_m = config.lateral_offset_sd_m + speed * (now - captured_s) * config.heading_sd_rad
        loose[2, 2], loose[3, 3] = config.heading_sd_rad**2, aside_m**2
        self._loose = loose
        self._bridge.corrected(now, before, self._state())
        self._heard_s = now

    def _arrive(self, heading: float, offset: float) -> None:
        k01, k02, k11, k12, k21, k22, k31, k32 = (
            self._row[i] for i in (18, 19, 21, 22, 24, 25, 27, 28)
        )
        before = self._state()
        self._left = self._propagated_steps
        self._b += k01 * heading + k02 * offset
        self._r += k11 * heading + k12 * offset
        self._h += k21 * heading + k22 * offset
        self._y += k31 * heading + k32 * offset
        self._eb = -k01 * heading - k02 * offset
        self._er = -k11 * heading - k12 * offset
        self._eh = (1.0 - k21) * heading - k22 * offset
        self._ey = -k31 * heading + (1.0 - k32) * offset
        self._bridge.corrected(self._clock.stamp_s, before, self._state())
        self._heard_s = self._clock.stamp_s

    def capture(self, kind: str, stamp_s: float) -> None:
        if kind == CAMERA:
            self._stored.append((stamp_s, self._h, self._y))
            del self._stored[: -self._config.camera_slots]

    def _state(self) -> Floats:
        return np.array([self._b, self._r, self._h, self._y])

    def _exact(self, inputs: Inputs, elapsed: float, row: tuple[float, ...]) -> tuple[float, ...]:
        g, h, _ = self._schedule.at(inputs.speed_mps, elapsed)
        numbers = [*g[0, :2], *g[1, :2], *g[2, :2], *g[3, :3], *h[:, 0], *h[:, 1]]
        return (*(float(v) for v in numbers), *row[17:])

    def _loosen(self, loose: Floats, stamp_s: float) -> list[float]:
        """Where the filter is not steady (the start, an outage and the time after one): its gain.

        The same Riccati recursion, stepped instead of solved, with the camera's columns off
        while no pictures come.
        """
        config, steady = self._config, self._covariances[self._index].reshape(4, 4)
        silent = self._silent(stamp_s)
        rows = ALL_ROWS[:1] if silent else ALL_ROWS
        frames = max(1.0, round(config.camera_period_s / config.step_s))
        sds = np.array([config.gyro_sd_radps, config.heading_sd_rad, config.lateral_offset_sd_m])
        noise = np.diag((sds**2 * (1.0, frames, frames))[: len(rows)])
        g, _, q = self._schedule.at(self._inputs.speed_mps)
        prior = g @ loose @ g.T + q
        gain = np.zeros((4, 3))
        gain[:, : len(rows)] = np.linalg.solve(rows @ prior @ rows.T + noise, rows @ prior).T
        p = symmetric(prior - gain[:, : len(rows)] @ rows @ prior)
        # the heading sharpens without end where its model is noise-free: it need not be waited for
        near = bool(np.all((np.diag(p) <= 1.02 * np.diag(steady))[[0, 1, 3]]))
        self._loose = None if near and not silent else p
        return [float(v) for v in gain.ravel()]

    def estimate(self) -> Estimate:
        mean = self._state()
        return self._bridge.output(self._clock.stamp_s, self.fields, mean, self.covariance())

    def covariance(self) -> Floats:
        if self._loose is not None:
            return self._loose.copy()
        return np.array(self._covariances[self._index]).reshape(4, 4)
