"""Continuous linear models to exact discrete ones: zero-order hold and Van Loan."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from polemap.vehicle.errors import VehicleError

Floats = NDArray[np.float64]


def zero_order_hold(a: Floats, b: Floats, period_s: float) -> tuple[Floats, Floats]:
    """`x' = A x + B u` with u held over `period_s`: `x+ = G x + H u`.

    Args:
        a: `(n, n)`.
        b: `(n, m)`.
        period_s: sampling period, not negative.

    Returns:
        G `(n, n)` and H `(n, m)`.

    Raises:
        VehicleError: shapes that do not fit or a negative period.

    Source: `expm([[A, B], [0, 0]] T) = [[G, H], [0, I]]` (errata.md, Discretisation).
    """
    n, m = _checked(a, b, period_s)
    block = np.zeros((n + m, n + m))
    block[:n, :n] = a
    block[:n, n:] = b
    exponential = scipy.linalg.expm(block * period_s)
    return exponential[:n, :n].copy(), exponential[:n, n:].copy()


def zero_order_hold_series(a: Floats, b: Floats, period_s: ArrayLike) -> tuple[Floats, Floats]:
    """`zero_order_hold` of many models at once by the series of the exponential, fourth order.

    The error is about |A T|^5 / 120 of the state.

    Args:
        a: `(..., n, n)`.
        b: `(..., n, m)`.
        period_s: `(...)`.

    Returns:
        G `(..., n, n)` and H `(..., n, m)`.
    """
    t = np.asarray(period_s, dtype=np.float64)[..., None, None]
    at = a * t
    square = at @ at
    one = np.eye(a.shape[-1])
    g = one + at + square / 2.0 + square @ at / 6.0 + square @ square / 24.0
    integral = t * (one + at / 2.0 + square / 6.0 + square @ at / 24.0)
    return g, integral @ b


def van_loan(a: Floats, density: Floats, period_s: float) -> tuple[Floats, Floats]:
    """Transition and noise covariance over `period_s` of `x' = A x + w`.

    Args:
        a: `(n, n)`.
        density: `(n, n)` spectral density of the white noise w.
        period_s: sampling period, not negative.

    Returns:
        G `(n, n)` and Q `(n, n)`, symmetric: `Q = integral of expm(A s) density expm(A s)'`.

    Raises:
        VehicleError: shapes that do not fit or a negative period.

    Source: Van Loan, Computing integrals involving the matrix exponential, IEEE TAC 23(3), 1978.
    """
    n, _ = _checked(a, density, period_s)
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n] = -a
    block[:n, n:] = density
    block[n:, n:] = a.T
    exponential = scipy.linalg.expm(block * period_s)
    transition = exponential[n:, n:].T.copy()
    noise = transition @ exponential[:n, n:]
    return transition, 0.5 * (noise + noise.T)


def _checked(a: Floats, b: Floats, period_s: float) -> tuple[int, int]:
    if a.ndim != 2 or a.shape[0] != a.shape[1] or b.ndim != 2 or b.shape[0] != a.shape[0]:
        raise VehicleError(f"model matrices of shapes {a.shape} and {b.shape} do not fit")
    if not period_s >= 0.0:
        raise VehicleError(f"sampling period is {period_s} s, it must not be negative")
    return a.shape[0], b.shape[1]
