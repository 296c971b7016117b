"""Both markings of a lane in one least-squares fit, with what is known of lane and camera."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, sqrt

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
CURVATURE_SD_PER_M = 0.006  # of roads, before anything is seen: a radius of 170 m
# a row's marking is found to 2 cm, and to a third of a pixel of some 800 px/rad with distance
POINT_SD_M, POINT_SD_RAD = 0.02, 0.0004
SAME_PAINT_M = 2.0  # a dash or so errs as one: what counts as one measurement
OUTLIER_SDS = 3.5


@dataclass(slots=True)
class Learned:
    """A quantity that scatters from picture to picture about a mean that drifts slowly.

    Attributes:
        mean, variance: of the mean.
        scatter: variance from picture to picture.
        drift: what the mean's variance grows by in a picture.
    """

    mean: float
    variance: float
    scatter: float
    drift: float

    @property
    def spread(self) -> float:
        """Variance of the next picture's value."""
        return self.variance + self.scatter

    def learn(self, value: float, variance: float) -> None:
        """A picture's posterior, which used this as its prior."""
        gain = self.variance / self.spread
        self.mean += gain * (value - self.mean)
        self.variance += self.drift - gain * gain * max(0.0, self.spread - variance)


@dataclass(frozen=True, slots=True)
class LaneFit:
    """Lane at the preview distance: `[left, right, slope, half curvature, divergence]`.

    Attributes:
        state: `(5,)`; the markings' y at the preview (m), their common slope there and half their
            curvature (1/m), and by how much their distance grows per metre and metre (1/m),
            which an error of the camera's pitch does: its size is that error over the height.
        covariance: `(5, 5)`.
        rms: of the residuals in units of their stated deviations.
    """

    state: Floats
    covariance: Floats
    rms: float

    def measurement(self) -> tuple[Floats, Floats]:
        """Heading (rad), offset from the lane's middle (m) and curvature (1/m), and `(3, 3)`.

        Heading and offset are the car's at the preview point, left positive.
        """
        left, right, slope, half, _ = self.state.tolist()
        c = 1.0 / sqrt(1.0 + slope * slope)
        middle = 0.5 * (left + right)
        value = np.array([-atan(slope), -middle * c, 2.0 * half * c**3])
        jacobian = np.zeros((3, 5))
        jacobian[0, 2] = -c * c
        jacobian[1, :3] = (-0.5 * c, -0.5 * c, middle * slope * c**3)
        jacobian[2, 3] = 2.0 * c**3
        return value, jacobian @ self.covariance @ jacobian.T


def fit_lane(
    sides: dict[str, Floats],
    preview_m: float,
    camera_x_m: float,
    width: Learned,
    divergence: Learned,
    curvature_per_m: tuple[float, float] = (0.0, CURVATURE_SD_PER_M),
) -> LaneFit:
    """Least squares over the points `(n, 2)` of one side or both (`left`, `right`).

    Both share slope and curvature; a missing one stands a lane's width beside the other. Points
    `curvature_per_m` is what is believed of it before, and its deviation. Points
    that lie more than 3.5 deviations off are left out of a second pass.
    """
    x = np.concatenate([p[:, 0] for p in sides.values()]) - preview_m
    y = np.concatenate([p[:, 1] for p in sides.values()])
    is_left = np.concatenate([np.full(len(p), side == "left") for side, p in sides.items()])
    ahead = x + preview_m - camera_x_m
    sd = np.hypot(POINT_SD_M, POINT_SD_RAD * ahead)
    share = _share(x, is_left)
    beside = np.where(is_left, y[is_left].mean() if is_left.any() else 0.0, 0.0)
    beside += np.where(~is_left, y[~is_left].mean() if not is_left.all() else 0.0, 0.0)
    keep = np.ones(len(x), dtype=bool)
    state: Floats = np.zeros(5)
    covariance: Floats = np.eye(5)
    rms = 1.0
    for _ in range(3):
        design = np.column_stack([is_left, ~is_left, x, x * x, beside * ahead]).astype(np.float64)
        weight = np.where(keep, share / sd**2, 0.0)
        information = design.T @ (design * weight[:, None])
        right = design.T @ (weight * y)
        prior = np.zeros((3, 5))
        prior[0, :2] = (1.0, -1.0)
        prior[1, 3] = prior[2, 4] = 1.0
        values = np.array([width.mean, 0.5 * curvature_per_m[0], divergence.mean])
        variances = np.array([width.spread, 0.25 * curvature_per_m[1] ** 2, divergence.spread])
        information += prior.T @ (prior / variances[:, None])
        right += prior.T @ (values / variances)
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        state = np.asarray(covariance @ right, dtype=np.float64)
        residual = (y - design @ state) / sd
        rms = float(np.sqrt(np.mean(residual[keep] ** 2)))
        beside = np.where(is_left, state[0], state[1])
        keep = np.abs(residual) < OUTLIER_SDS * max(1.0, rms)
    return LaneFit(state, covariance * max(1.0, rms * rms), rms)


def _share(x: Floats, is_left: NDArray[np.bool_]) -> Floats:
    """What each point counts `(n,)`: those of one side within two metres are one together."""
    cell = np.round(x / SAME_PAINT_M).astype(np.int64) * 2 + is_left
    _, inverse, counts = np.unique(cell, return_inverse=True, return_counts=True)
    return 1.0 / counts[inverse]
