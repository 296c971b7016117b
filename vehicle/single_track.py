"""Linear models of a car for its estimators: continuous matrices, and a fast discrete schedule.

Axes ISO 8855, SI units. Below `KINEMATIC_SPEED_MPS` the tyre terms 1/V become singular; there the
side-slip and the yaw rate relax to what rolling without slip prescribes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import cos, log, sin

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from polemap.vehicle.discretize import van_loan, zero_order_hold
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]
Model = Callable[[Car, float], tuple[Floats, Floats]]

KINEMATIC_SPEED_MPS = 1.0
TOP_SPEED_MPS = 90.0
_SLOW_ROWS = 128
_FAST_ROWS = 1024


def lateral(car: Car, speed_mps: float) -> tuple[Floats, Floats]:
    """Single-track model: A `(2, 2)`, B `(2, 2)`; state `[side-slip, yaw rate]`.

    Inputs are the road-wheel angle and the yaw moment. With k0 = 2(Cf+Cr),
    k1 = 2(Cf lf - Cr lr), k2 = 2(Cf lf^2 + Cr lr^2):
    beta' = -k0/(mV) beta - (1 + k1/(mV^2)) gamma + 2Cf/(mV) delta,
    gamma' = -k1/I beta - k2/(IV) gamma + 2 Cf lf/I delta + Nz/I.

    Source: W14 (1), (2) as corrected in errata.md.
    """
    v = speed_mps
    if v >= KINEMATIC_SPEED_MPS:
        return lateral_on_tyres(car, v)
    m, inertia = car.mass_kg, car.yaw_inertia_kgm2
    lf, lr = car.cg_to_front_m, car.cg_to_rear_m
    k0 = 2.0 * (car.front_stiffness_nprad + car.rear_stiffness_nprad)
    k2 = 2.0 * (car.front_stiffness_nprad * lf**2 + car.rear_stiffness_nprad * lr**2)
    # relax to beta = lr/l delta, gamma = V/l delta as fast as the tyres do at the limit speed
    fast_beta, fast_gamma = k0 / (m * KINEMATIC_SPEED_MPS), k2 / (inertia * KINEMATIC_SPEED_MPS)
    length = lf + lr
    a = np.diag([-fast_beta, -fast_gamma])
    b = np.array([[fast_beta * lr / length, 0.0], [fast_gamma * v / length, 0.0]])
    return a, b


def lateral_on_tyres(car: Car, speed_mps: ArrayLike) -> tuple[Floats, Floats]:
    """`lateral` from the kinematic limit up, at many speeds `(...)` at once.

    Returns:
        A `(..., 2, 2)` and B `(..., 2, 2)`.
    """
    m, inertia = car.mass_kg, car.yaw_inertia_kgm2
    lf, lr = car.cg_to_front_m, car.cg_to_rear_m
    cf, cr = car.front_stiffness_nprad, car.rear_stiffness_nprad
    k0, k1 = 2.0 * (cf + cr), 2.0 * (cf * lf - cr * lr)
    k2 = 2.0 * (cf * lf**2 + cr * lr**2)
    v = np.asarray(speed_mps, dtype=np.float64)
    a, b = np.empty((*v.shape, 2, 2)), np.empty((*v.shape, 2, 2))
    a[..., 0, 0], a[..., 0, 1] = -k0 / (m * v), -1.0 - k1 / (m * v * v)
    a[..., 1, 0], a[..., 1, 1] = -k1 / inertia, -k2 / (inertia * v)
    b[..., 0, 0], b[..., 0, 1] = 2.0 * cf / (m * v), 0.0
    b[..., 1, 0], b[..., 1, 1] = 2.0 * cf * lf / inertia, 1.0 / inertia
    return a, b


def combined_vision(car: Car, speed_mps: float) -> tuple[Floats, Floats]:
    """Vehicle and vision: A `(4, 4)`, B `(4, 2)`; state `[beta, gamma, psi, y_l]`.

    psi' = gamma; y_l' = V beta + l_pre gamma + V psi: heading in the lane and lateral offset of
    the car at the preview point, both positive to the left.

    Source: W14 (6)-(8).
    """
    a, b = np.zeros((4, 4)), np.zeros((4, 2))
    a[:2, :2], b[:2] = lateral(car, speed_mps)
    a[2, 1] = 1.0
    a[3, :3] = (speed_mps, car.preview_m, speed_mps)
    return a, b


def bend_of_lane(speed_mps: float, curvature_per_m: float, period_s: float) -> tuple[float, float]:
    """What a bent lane adds to heading (rad) and offset (m) of `combined_vision` over a step.

    psi' = gamma - V kappa, kappa the curvature at the preview point, to the left positive; y_l'
    stays as it is: both are counted at the preview point, which moves along the lane's tangent
    there. Exact for a curvature that holds over the step. The papers' model has straight lanes.
    """
    turned = speed_mps * curvature_per_m * period_s
    return -turned, -0.5 * speed_mps * period_s * turned


def gps_course(car: Car, speed_mps: float) -> tuple[Floats, Floats]:
    """Vehicle and heading: A `(3, 3)`, B `(3, 2)`; state `[beta, gamma, psi]`, course psi + beta.

    Source: N13 (1)-(5).
    """
    a, b = np.zeros((3, 3)), np.zeros((3, 2))
    a[:2, :2], b[:2] = lateral(car, speed_mps)
    a[2, 1] = 1.0
    return a, b


def disturbed_course(car: Car, speed_mps: float, time_constant_s: float) -> tuple[Floats, Floats]:
    """`gps_course` with leaky disturbances of side-slip and yaw rate: A `(5, 5)`, B `(5, 2)`.

    beta' += d_beta, gamma' += d_gamma, d' = -d / time constant + noise. As random walks only
    four of the five states are observable; the leak makes all five so.

    Source: N13 (18), (19) as corrected in errata.md.
    """
    a, b = np.zeros((5, 5)), np.zeros((5, 2))
    a[:3, :3], b[:3] = gps_course(car, speed_mps)
    a[0, 3] = a[1, 4] = 1.0
    a[3, 3] = a[4, 4] = -1.0 / time_constant_s
    return a, b


def planar_velocity_step(
    yaw_rate_radps: float, period_s: float
) -> tuple[float, float, float, float]:
    """`[vx, vy]` driven by `[ax, ay]`: `(c, s, ch, sh)` of v+ = [[c, s], [-s, c]] v + push a.

    vx' = ax + gamma vy, vy' = ay - gamma vx over a step. The accelerations a are held and taken at
    half of the turn: push = [[ch, sh], [-sh, ch]]. Plain floats, because the estimators step a
    thousand times a second.

    Source: N13 (7)-(10).
    """
    turn = yaw_rate_radps * period_s
    half = 0.5 * turn
    return cos(turn), sin(turn), period_s * cos(half), period_s * sin(half)


def lateral_acceleration_rows(car: Car, speed_mps: float) -> tuple[Floats, Floats]:
    """Rows C `(2,)`, D `(2,)` of ay = V (beta' + gamma) in `[beta, gamma]` and `[delta, Nz]`."""
    a, b = lateral(car, speed_mps)
    return speed_mps * (a[0] + (0.0, 1.0)), speed_mps * b[0]


class Schedule:
    """`G, H, Q` of a model as a function of speed: one table look-up instead of two expm a step.

    Rows lie evenly in V below the kinematic limit and evenly in log V above it, exact at the
    rows and linear between; `error` measures what that costs. `at` writes into buffers of its
    own and returns the same three views each time.

    Args:
        model: `(car, speed) -> (A, B)`.
        car: parameters.
        density: `(n, n)` spectral density of the process noise.
        period_s: step.
    """

    def __init__(self, model: Model, car: Car, density: Floats, period_s: float) -> None:
        if not period_s > 0.0:
            raise VehicleError(f"step of the schedule is {period_s} s, it must be positive")
        self.period_s = period_s
        self._model, self._car, self._density = model, car, density
        a, b = model(car, 10.0)
        self._n, self._m = a.shape[0], b.shape[1]
        slow = np.linspace(0.0, KINEMATIC_SPEED_MPS, _SLOW_ROWS, endpoint=False)
        fast = np.exp(np.linspace(log(KINEMATIC_SPEED_MPS), log(TOP_SPEED_MPS), _FAST_ROWS))
        # the model jumps at the limit: the last slow interval must end on the slow side's value
        edge = np.nextafter(KINEMATIC_SPEED_MPS, 0.0)
        self._slow = self._rows(np.append(slow, edge))
        self._fast = self._rows(fast)
        self._slow_step, self._fast_step = np.diff(self._slow, axis=0), np.diff(self._fast, axis=0)
        self._per_mps = _SLOW_ROWS / KINEMATIC_SPEED_MPS
        self._per_log = (_FAST_ROWS - 1) / log(TOP_SPEED_MPS / KINEMATIC_SPEED_MPS)
        n, m = self._n, self._m
        self._buffer = np.zeros(n * (2 * n + m))
        self.transition = self._buffer[: n * n].reshape(n, n)
        self.drive = self._buffer[n * n : n * (n + m)].reshape(n, m)
        self.noise = self._buffer[n * (n + m) :].reshape(n, n)

    def at(self, speed_mps: float, period_s: float | None = None) -> tuple[Floats, Floats, Floats]:
        """Views G `(n, n)`, H `(n, m)`, Q `(n, n)`; they hold until the next call.

        A step that is not the schedule's own, and a speed beyond its ends, is done exactly.
        """
        off = period_s is not None and abs(period_s - self.period_s) > 1e-6
        if off or not 0.0 <= speed_mps < TOP_SPEED_MPS:
            self._buffer[:] = self._exact_row(speed_mps, period_s if off else self.period_s)
            return self.transition, self.drive, self.noise
        if speed_mps >= KINEMATIC_SPEED_MPS:
            position = log(speed_mps) * self._per_log
            index = int(position)
            if index >= _FAST_ROWS - 1:
                index = _FAST_ROWS - 2
            np.multiply(self._fast_step[index], position - index, out=self._buffer)
            self._buffer += self._fast[index]
        else:
            position = speed_mps * self._per_mps
            index = int(position)
            np.multiply(self._slow_step[index], position - index, out=self._buffer)
            self._buffer += self._slow[index]
        return self.transition, self.drive, self.noise

    def exact(self, speed_mps: float) -> tuple[Floats, Floats, Floats]:
        """G, H, Q by matrix exponentials, the oracle of `at`."""
        a, b = self._model(self._car, speed_mps)
        g, h = zero_order_hold(a, b, self.period_s)
        return g, h, van_loan(a, self._density, self.period_s)[1]

    def error(self, speeds_mps: Floats) -> dict[str, float]:
        """Largest difference of `at` from `exact`, each relative to its matrix's largest entry."""
        worst = {"transition": 0.0, "drive": 0.0, "noise": 0.0}
        for speed in speeds_mps:
            for name, fast, exact in zip(
                worst, self.at(float(speed)), self.exact(float(speed)), strict=True
            ):
                scale = np.abs(exact).max() or 1.0
                worst[name] = max(worst[name], float(np.abs(fast - exact).max() / scale))
        return worst

    def _exact_row(self, speed_mps: float, period_s: float | None) -> Floats:
        period = self.period_s if period_s is None else period_s
        a, b = self._model(self._car, speed_mps)
        g, h = zero_order_hold(a, b, period)
        q = van_loan(a, self._density, period)[1]
        return np.concatenate([g.ravel(), h.ravel(), q.ravel()])

    def _rows(self, speeds_mps: Floats) -> Floats:
        """Exact rows `(k, n (2n + m))`, the exponentials of all speeds in two calls."""
        n, m, k = self._n, self._m, len(speeds_mps)
        pairs = [self._model(self._car, float(v)) for v in speeds_mps]
        a, b = np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])
        block = np.zeros((k, n + m, n + m))
        block[:, :n, :n], block[:, :n, n:] = a, b
        held = scipy.linalg.expm(block * self.period_s)
        loan = np.zeros((k, 2 * n, 2 * n))
        loan[:, :n, :n], loan[:, :n, n:], loan[:, n:, n:] = -a, self._density, a.transpose(0, 2, 1)
        e = scipy.linalg.expm(loan * self.period_s)
        q = e[:, n:, n:].transpose(0, 2, 1) @ e[:, :n, n:]
        q = 0.5 * (q + q.transpose(0, 2, 1))
        parts = (held[:, :n, :n], held[:, :n, n:], q)
        return np.concatenate([part.reshape(k, -1) for part in parts], axis=1)


@lru_cache(maxsize=32)
def _tables(model: Model, car: Car, density: tuple[float, ...], period_s: float) -> Schedule:
    return Schedule(model, car, np.diag(density), period_s)


def schedule(model: Model, car: Car, density: tuple[float, ...], period_s: float) -> Schedule:
    """A schedule with its own buffers; tables of equal arguments are computed once.

    `density` is the diagonal of the process noise's spectral density.
    """
    shared = _tables(model, car, density, period_s)
    own = object.__new__(Schedule)
    own.__dict__.update(shared.__dict__)
    n, m = shared._n, shared._m
    own._buffer = np.zeros_like(shared._buffer)
    own.transition = own._buffer[: n * n].reshape(n, n)
    own.drive = own._buffer[n * n : n * (n + m)].reshape(n, m)
    own.noise = own._buffer[n * (n + m) :].reshape(n, n)
    return own
