"""Errors that last: the stated covariance against thousands of drives of the same estimator."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.drivelog.detections import Detections, pole_detections
from polemap.extras import kernel
from polemap.localize.particle_filter.landmarks import Landmarks
from polemap.localize.particle_filter.persistent_errors import (
    KERNEL,
    PersistentErrors,
    at_least,
    plain_scan,
)

Floats = np.ndarray[Any, np.dtype[np.float64]]

POLES = np.array([[24.0, 7.0], [26.0, 0.0], [28.0, 9.0], [40.0, -6.0], [46.0, 5.0]])
SEEN_VAR, MAP_VAR, SHARE = np.diag([0.16, 0.0025]), 0.0025, 0.2
DRAWS = 4000


def _landmarks(rows: Floats) -> Landmarks:
    n = len(rows)
    return Landmarks(
        np.zeros(n, dtype=np.int8), POLES[rows], np.tile([MAP_VAR, MAP_VAR, 0.0], (n, 1)),
        np.full(n, 0.2), np.full(n, 0.9), rows.astype(np.int64),
    )  # fmt: skip


def _scan(points: Floats) -> Detections:
    return pole_detections(0.0, 0.0, points, np.tile(SEEN_VAR, (len(points), 1, 1)))


class _Estimator:
    """The particles' gain in a Kalman filter, in many drives with errors of their own."""

    def __init__(self, rng: np.random.Generator, particles: Floats) -> None:
        self.particles = particles
        self.error = rng.multivariate_normal(np.zeros(3), particles, DRAWS)
        self._rng = rng
        self._of_pole = {
            row: (
                rng.multivariate_normal(np.zeros(2), 0.5 * SEEN_VAR, DRAWS)
                + rng.normal(0.0, np.sqrt(MAP_VAR), (DRAWS, 2))
            )
            for row in range(len(POLES))
        }

    def drive(self, ahead_m: float, scale: Floats, noise: float) -> None:
        transition = np.eye(3)
        transition[1, 2] = ahead_m
        self.error = self.error @ transition.T
        self.error[:, 0] += ahead_m * scale
        self.particles = transition @ self.particles @ transition.T + noise * np.eye(3)

    def look(self, pose: Floats, rows: Floats) -> None:
        arm = POLES[rows] - pose[:2]
        jacobian = np.zeros((len(rows), 2, 3))
        jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
        jacobian[:, 0, 2], jacobian[:, 1, 2] = -arm[:, 1], arm[:, 0]
        flat = jacobian.reshape(-1, 3)
        variance = np.kron(np.eye(len(rows)), (SEEN_VAR + MAP_VAR * np.eye(2)) / SHARE)
        gain = self.particles @ flat.T @ np.linalg.inv(flat @ self.particles @ flat.T + variance)
        lasting = np.concatenate([self._of_pole[int(row)] for row in rows], axis=1)
        white = self._rng.multivariate_normal(
            np.zeros(2), 0.5 / SHARE * SEEN_VAR, (DRAWS, len(rows))
        ).reshape(DRAWS, -1)
        self.error = self.error - (self.error @ flat.T + lasting + white) @ gain.T
        self.particles = (np.eye(3) - gain @ flat) @ self.particles


def test_the_covariance_is_that_of_many_drives() -> None:
    """Twenty looks at three far poles while standing, a way that only odometry tells with a scale
    that is not known, then two new poles."""
    rng = np.random.default_rng(3)
    start = np.diag([2.0, 2.0, 0.05]) ** 2
    estimator, persistent = _Estimator(rng, start), PersistentErrors(0.0)
    persistent.start(start)
    pose = np.zeros(3)

    def look(rows: Floats) -> None:
        persistent.add_scan(
            estimator.particles, _scan(POLES[rows] - pose[:2]), _landmarks(rows), pose,
            np.arange(len(rows), dtype=np.int32), SHARE,
        )  # fmt: skip
        estimator.look(pose, rows)

    for _ in range(20):
        look(np.array([0, 1, 2]))
    _compare(persistent, estimator)
    # the particles take each look for new evidence, and are too sure
    assert persistent.covariance[1, 1] > 2.0 * estimator.particles[1, 1]
    scale, ahead = 0.02 * rng.standard_normal(DRAWS), np.array([1.5, 0.0, 0.0])
    for _ in range(10):
        persistent.move(pose[None], (pose + ahead)[None], 0.15, (0.02, 0.0))
        pose = pose + ahead
        estimator.drive(1.5, scale, 1e-4)
    _compare(persistent, estimator)
    for _ in range(5):
        look(np.array([2, 3, 4]))
    _compare(persistent, estimator)


def _compare(persistent: PersistentErrors, estimator: _Estimator) -> None:
    root = np.linalg.inv(np.linalg.cholesky(persistent.covariance))
    whitened = estimator.error @ root.T
    # five standard deviations of a variance from so many drives
    np.testing.assert_allclose(np.cov(whitened.T), np.eye(3), atol=5.0 * np.sqrt(2.0 / DRAWS))


def test_an_offset_of_the_yaw_rate_bends_the_way() -> None:
    persistent = PersistentErrors(0.0)
    persistent.start(np.zeros((3, 3)))
    pose, ahead = np.zeros(3), np.array([1.0, 0.0, 0.0])
    for _ in range(100):
        persistent.move(pose[None], (pose + ahead)[None], 0.1, (0.0, 0.01))
        pose = pose + ahead
    # 0.01 rad/s for 10 s, and half of that over 100 m
    sd = np.sqrt(np.diag(persistent.covariance))
    assert sd == pytest.approx([0.0, 5.0, 0.1], rel=1e-6, abs=1e-9)


def test_a_fix_tells_the_position() -> None:
    persistent = PersistentErrors(0.0)
    persistent.start(np.diag([4.0, 4.0, 0.01]))
    # what the particles are left with after a fix of 2 m
    persistent.add_fixes(np.diag([2.0, 2.0, 0.01]), 0.25)
    np.testing.assert_allclose(persistent.covariance, np.diag([2.0, 2.0, 0.01]))
    persistent.add_fixes(np.diag([2.0, 2.0, 0.01]), 0.0)
    np.testing.assert_allclose(persistent.covariance, np.diag([2.0, 2.0, 0.01]))


def test_only_the_last_poles_are_kept() -> None:
    persistent = PersistentErrors(0.0)
    rows = np.array([0, 1, 2])
    for first in range(0, 300, 3):
        landmarks = _landmarks(rows)
        landmarks = Landmarks(
            landmarks.kind, landmarks.points_m, landmarks.covariance_m2, landmarks.width_m,
            landmarks.detection, rows + first,
        )  # fmt: skip
        persistent.add_scan(
            np.eye(3), _scan(POLES[rows]), landmarks, np.zeros(3), np.arange(3, dtype=np.int32), 1.0
        )
    assert persistent._poles.shape == (3, 32)
    assert np.isfinite(persistent.covariance).all()


def test_poles_without_any_error_leave_a_covariance() -> None:
    persistent = PersistentErrors(0.0)
    rows = np.array([0, 1, 2])
    exact = pole_detections(0.0, 0.0, POLES[rows], np.zeros((3, 2, 2)))
    landmarks = _landmarks(rows)
    landmarks.covariance_m2[:] = 0.0
    persistent.add_scan(np.eye(3), exact, landmarks, np.zeros(3), np.arange(3, dtype=np.int32), 1.0)
    assert (np.diag(persistent.covariance) < 1e-6).all()
    at_least(persistent.covariance, np.eye(3))


@given(st.integers(0, 2**32 - 1))
def test_neither_covariance_is_undercut(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = (m @ m.T + 1e-6 * np.eye(3) for m in rng.normal(size=(2, 3, 3)))
    joined = at_least(a, b)
    for below in (a, b):
        assert np.linalg.eigvalsh(joined - below)[0] > -1e-9
    np.testing.assert_allclose(at_least(a, 0.5 * a), a)
    np.testing.assert_allclose(at_least(a, 2.0 * a), 2.0 * a, rtol=1e-5)


particle_kernel = kernel(KERNEL)


@pytest.mark.skipif(particle_kernel is None, reason="the kernel was not built here")
@pytest.mark.parametrize("count", [1, 5, 14])
def test_the_kernel_equals_plain_numpy(count: int) -> None:
    assert particle_kernel is not None
    rng = np.random.default_rng(count)
    root, error = rng.normal(0.0, 0.3, (3, 3)), rng.normal(0.0, 0.2, (3, 3))
    seen, mapped = rng.normal(0.0, 0.2, (2, count, 2, 2))
    mapped = mapped @ np.swapaxes(mapped, 1, 2) + 0.01 * np.eye(2)
    scan = (
        root @ root.T + 0.01 * np.eye(3), error @ error.T, rng.normal(0.0, 0.1, (3, 2 * 16)),
        rng.uniform(-30.0, 30.0, (count, 2)), seen @ np.swapaxes(seen, 1, 2),
        np.stack([mapped[:, 0, 0], mapped[:, 1, 1], mapped[:, 0, 1]], axis=1),
        2 * rng.permutation(16)[:count], 2.2, 0.02, 0.3, 0.5,
    )  # fmt: skip
    for fast, plain in zip(particle_kernel.add_scan(*scan), plain_scan(*scan), strict=True):
        np.testing.assert_allclose(fast, plain, rtol=1e-9, atol=1e-12)
    with pytest.raises(ValueError, match="columns has the wrong shape"):
        particle_kernel.add_scan(*scan[:6], np.full(count, 31), *scan[7:])
