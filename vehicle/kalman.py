"""The Kalman filter's parts, for any number of states: small, stateless, in their safest form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import isfinite
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.vehicle.errors import VehicleError
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Innovation:
    """What a measurement says against a prediction, before anything is changed.

    Attributes:
        residual: `(m,)` measured minus predicted, angles wrapped.
        covariance: `(m, m)` `S = H P H' + R`.
        gain: `(n, m)` `K = P H' inv(S)`.
        nis: `r' inv(S) r`, the squared Mahalanobis distance.
    """

    residual: Floats
    covariance: Floats
    gain: Floats
    nis: float


def predict(covariance: Floats, transition: Floats, noise: Floats) -> Floats:
    """`F P F' + Q`, symmetric to the last bit; `(n, n)`."""
    return symmetric(transition @ covariance @ transition.T + noise)


def angle_residual(measured: Floats, predicted: Floats, angle_rows: Sequence[int] = ()) -> Floats:
    """Measured minus predicted `(m,)`, the rows that are angles wrapped to [-pi, pi)."""
    residual = np.asarray(measured, dtype=np.float64) - predicted
    for row in angle_rows:
        residual[row] = wrap_angle(residual[row])
    return residual


def innovate(residual: Floats, covariance: Floats, jacobian: Floats, noise: Floats) -> Innovation:
    """Innovation of a measurement with `jacobian` H `(m, n)` and `noise` R `(m, m)`.

    Raises:
        VehicleError: `H P H' + R` is not positive definite.
    """
    cross = covariance @ jacobian.T
    s = symmetric(jacobian @ cross + noise)
    try:
        np.linalg.cholesky(s)
    except np.linalg.LinAlgError as error:
        raise VehicleError(
            f"innovation covariance is not positive definite (diagonal {np.diag(s)}); "
            "the measurement's covariance must be"
        ) from error
    solved = np.linalg.solve(s, np.column_stack([cross.T, residual]))
    gain = np.ascontiguousarray(solved[:, :-1].T)
    return Innovation(residual, s, gain, float(residual @ solved[:, -1]))


def joseph_update(
    state: Floats, covariance: Floats, innovation: Innovation, jacobian: Floats, noise: Floats
) -> tuple[Floats, Floats]:
    """State `(n,)` and covariance `(n, n)` after a measurement: `(I - K H) P (I - K H)' + K R K'`.

    The Joseph form stays symmetric and positive definite for any gain. Angles in the state are
    the caller's to wrap.
    """
    gain = innovation.gain
    keep = np.eye(len(state)) - gain @ jacobian
    updated = keep @ covariance @ keep.T + gain @ noise @ gain.T
    return state + gain @ innovation.residual, symmetric(updated)


@lru_cache(maxsize=256)
def chi_square_gate(probability: float, dof: int) -> float:
    """Limit on the *squared* Mahalanobis distance that a true measurement keeps with `probability`.

    Raises:
        VehicleError: a probability outside (0, 1) or fewer than one degree of freedom.
    """
    if not 0.0 < probability < 1.0:
        raise VehicleError(f"gate probability is {probability}, it must lie between 0 and 1")
    if dof < 1:
        raise VehicleError(f"a gate needs at least 1 degree of freedom, not {dof}")
    return chi_square_quantile(probability, dof)


def chi_square_quantile(probability: float, dof: float) -> float:
    """Value that a chi-square variable of `dof` degrees of freedom keeps with `probability`.

    It is `scipy.stats.chi2.ppf` without the second that importing `scipy.stats` takes.
    """
    return float(2.0 * scipy.special.gammaincinv(0.5 * dof, probability))


def symmetric(matrix: Floats) -> Floats:
    """The symmetric part of a square matrix."""
    return 0.5 * (matrix + matrix.T)


def is_covariance(matrix: Any) -> bool:
    """Whether a matrix is finite, symmetric (to 1e-9 of its size) and positive definite."""
    m = np.asarray(matrix, dtype=np.float64)
    if m.ndim != 2 or m.shape[0] != m.shape[1] or not np.isfinite(m).all():
        return False
    if np.abs(m - m.T).max() > 1e-9 * np.abs(m).max():
        return False
    try:
        np.linalg.cholesky(m)
    except np.linalg.LinAlgError:
        return False
    return True


def normalized_error(error: Floats, covariance: Floats) -> float:
    """NEES or NIS: `e' inv(P) e`, NaN where the error or the covariance is not usable."""
    if not np.isfinite(error).all() or not isfinite(float(covariance.sum())):
        return float("nan")
    try:
        return float(error @ np.linalg.solve(covariance, error))
    except np.linalg.LinAlgError:
        return float("nan")
