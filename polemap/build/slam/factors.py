"""Factors that GTSAM lacks, for all rows at once: motions with a calibration, and fixes.

A factor written in Python is called back once a row, a linearisation and an evaluation, which is
most of the time of a large graph. These are linearised by arrays, and given to GTSAM as linear
factors, whitened and weighted by their robust kernels.

Source: Barron, A general and adaptive robust loss function, CVPR 2019 (the losses of Huber and
Cauchy, and the weights that minimise them when iterated).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.build.slam.problem import Problem
from polemap.vehicle.pose import pose_rotation, relative, rotate, rotation, wrap_angle

Floats = NDArray[np.float64]

# residuals, in standard deviations, from which a factor loses weight
MOTION_HUBER, FIX_CAUCHY = 3.0, 2.0


class OwnFactors:
    """Motions and fixes of a problem; residuals as in `graph`."""

    def __init__(self, problem: Problem) -> None:
        p = self._problem = problem
        self._whitening = np.linalg.inv(np.linalg.cholesky(p.motion_covariance))
        about = p.calibration[p.motion_calibration]
        self._start = p.motion - np.einsum("nij,nj->ni", p.motion_jacobian, about)
        self._by_calibration = -self._whitening @ p.motion_jacobian
        # by a step forward, to the left, and a turn
        self._lever = np.zeros((len(p.fix_from), 2, 3))
        self._lever[:, 0, 0] = self._lever[:, 1, 1] = 1.0
        self._lever[:, 0, 2], self._lever[:, 1, 2] = -p.fix_antenna_m[:, 1], p.fix_antenna_m[:, 0]

    def loss(self, poses: Floats, calibration: Floats, bias_m: Floats) -> float:
        """Half the sum of squared residuals in their deviations, by robust kernels."""
        motion, _ = self._motion(poses, calibration)
        size = np.sqrt(np.sum(motion**2, axis=1))
        k = MOTION_HUBER
        huber = np.where(size <= k, 0.5 * size**2, k * (size - 0.5 * k))
        fix2 = np.sum(self._fix(poses, bias_m) ** 2, axis=1)
        cauchy = 0.5 * FIX_CAUCHY**2 * np.log1p(fix2 / FIX_CAUCHY**2)
        return float(huber.sum() + cauchy.sum())

    def add_to(
        self, linear: Any, gtsam: Any, poses: Floats, calibration: Floats, bias_m: Floats
    ) -> None:
        """Add the linearised factors to a Gaussian factor graph."""
        p, factor = self._problem, gtsam.JacobianFactor
        x, c, b = (gtsam.symbol(kind, 0) for kind in "xcb")
        motion, moved = self._motion(poses, calibration)
        weight = np.sqrt(
            MOTION_HUBER / np.maximum(np.sqrt(np.sum(motion**2, axis=1)), MOTION_HUBER)
        )
        before = np.zeros((len(motion), 3, 3))
        before[:, [0, 1, 2], [0, 1, 2]] = -1.0
        before[:, 0, 2], before[:, 1, 2] = moved[:, 1], -moved[:, 0]
        scaled = weight[:, None, None] * self._whitening
        before, after = scaled @ before, scaled @ pose_rotation(moved[:, 2])
        by_calibration = weight[:, None, None] * self._by_calibration
        unit = gtsam.noiseModel.Unit.Create(3)
        rows = zip(
            (x + p.motion_from).tolist(), before, after, (c + p.motion_calibration).tolist(),
            by_calibration, -weight[:, None] * motion, strict=True,
        )  # fmt: skip
        for key, first, second, number, third, off in rows:
            linear.push_back(factor(key, first, key + 1, second, number, third, off, unit))
        fix = self._fix(poses, bias_m)
        weight = 1.0 / np.sqrt(1.0 + np.sum(fix**2, axis=1) / FIX_CAUCHY**2)
        share = weight / p.fix_sd_m
        by_pose = share[:, None, None] * (rotation(poses[p.fix_from, 2]) @ self._lever)
        by_bias = share[:, None, None] * np.eye(2)
        unit = gtsam.noiseModel.Unit.Create(2)
        rows = zip(
            (x + p.fix_from).tolist(), by_pose, (b + p.fix_bias).tolist(), by_bias,
            -weight[:, None] * fix, strict=True,
        )  # fmt: skip
        for key, first, other, second, off in rows:
            linear.push_back(factor(key, first, other, second, off, unit))

    def _motion(self, poses: Floats, calibration: Floats) -> tuple[Floats, Floats]:
        """Residuals of the motions `(a, 3)` in their deviations, and the motions themselves."""
        p = self._problem
        moved = relative(poses[p.motion_from], poses[p.motion_from + 1])
        by = np.einsum("nij,nj->ni", p.motion_jacobian, calibration[p.motion_calibration])
        off = moved - self._start - by
        off[:, 2] = wrap_angle(off[:, 2])
        return np.einsum("nij,nj->ni", self._whitening, off), moved

    def _fix(self, poses: Floats, bias_m: Floats) -> Floats:
        """Residuals of the fixes `(c, 2)` in their deviations."""
        p = self._problem
        pose = poses[p.fix_from]
        there = rotate(p.fix_antenna_m, pose[:, 2]) + pose[:, :2]
        return np.asarray((there + bias_m[p.fix_bias] - p.fix_m) / p.fix_sd_m[:, None])
