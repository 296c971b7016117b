"""Motion from points: exact without noise, consistent with it, blind to what moves by itself."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from polemap.stereo.odometry.motion import (
    fit_motion,
    move,
    project,
    project_jacobian,
    triangulate,
)
from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]
RIG = StereoRig(800, 480, 700.0, 400.0, 240.0, 0.4)
NOISE = 0.3**2 * np.eye(3)


def _transform(shift: tuple[float, ...], turn: tuple[float, ...]) -> Floats:
    transform = np.eye(4)
    transform[:3, :3] = cv2.Rodrigues(np.array(turn))[0]
    transform[:3, 3] = shift
    return transform


TRUE = _transform((0.03, -0.02, -0.9), (0.004, -0.03, 0.002))


def _points(count: int, rng: np.random.Generator) -> Floats:
    depth = rng.uniform(5.0, 40.0, count)
    u, v = rng.uniform(20, 780, count), rng.uniform(20, 460, count)
    return RIG.camera_points(u, v, RIG.focal_px * RIG.baseline_m / depth)


def test_exact_sights_give_the_exact_motion_from_no_guess() -> None:
    points = _points(60, np.random.default_rng(1))
    spread = np.tile(1e-6 * np.eye(3), (60, 1, 1))
    fit = fit_motion(RIG, points, spread, project(RIG, move(TRUE, points)), NOISE, np.eye(4))
    assert fit.inliers.all()
    assert fit.current_from_previous == pytest.approx(TRUE, abs=1e-6)


def test_the_jacobian_is_the_derivative() -> None:
    points = _points(5, np.random.default_rng(2))
    step = 1e-6
    for axis in range(3):
        ahead, behind = points.copy(), points.copy()
        ahead[:, axis] += step
        behind[:, axis] -= step
        slope = (project(RIG, ahead) - project(RIG, behind)) / (2 * step)
        assert project_jacobian(RIG, points)[:, :, axis] == pytest.approx(slope, rel=1e-4, abs=1e-4)


def test_triangulating_inverts_the_projection() -> None:
    points = _points(20, np.random.default_rng(3))
    again, spread = triangulate(RIG, project(RIG, points), NOISE)
    assert again == pytest.approx(points, rel=1e-9)
    assert (np.linalg.eigvalsh(spread) > 0).all()


@pytest.mark.parametrize("moving", [0.0, 0.4, 0.6])
def test_points_that_move_by_themselves_do_not_count(moving: float) -> None:
    rng = np.random.default_rng(4)
    points = _points(150, rng)
    now = move(TRUE, points)
    # a lorry that drives ahead: its points share a motion of their own
    others = rng.permutation(150)[: int(150 * moving)]
    now[others] += (1.5, 0.0, 1.2)
    seen = project(RIG, now) + 0.3 * rng.standard_normal((150, 3))
    before = project(RIG, points) + 0.3 * rng.standard_normal((150, 3))
    guessed, spread = triangulate(RIG, before, NOISE)
    # the step before was nearly the same, as it is in a drive
    fit = fit_motion(RIG, guessed, spread, seen, NOISE, _transform((0, 0, -0.8), (0, -0.02, 0)))
    assert np.linalg.norm(fit.current_from_previous[:3, 3] - TRUE[:3, 3]) < 0.05
    wrongly = fit.inliers[others].sum()
    assert wrongly <= 0.1 * max(len(others), 1)


def test_the_stated_covariance_is_the_spread_of_independent_corners_times_four() -> None:
    """The factor stands for corners that err alike; these here do not."""
    rng = np.random.default_rng(5)
    errors = []
    for _ in range(200):
        points = _points(80, rng)
        before = project(RIG, points) + 0.3 * rng.standard_normal((80, 3))
        seen = project(RIG, move(TRUE, points)) + 0.3 * rng.standard_normal((80, 3))
        guessed, spread = triangulate(RIG, before, NOISE)
        fit = fit_motion(RIG, guessed, spread, seen, NOISE, TRUE)
        difference = fit.current_from_previous @ np.linalg.inv(TRUE)
        turn = cv2.Rodrigues(difference[:3, :3])[0].ravel()
        error = np.concatenate([difference[:3, 3], turn])
        errors.append(4.0 * error @ np.linalg.solve(fit.covariance, error))
    low, high = stats.chi2.ppf([0.001, 0.999], 6 * 200) / 200
    # far points bend the covariance a little: within a quarter of the exact law
    assert 0.75 * low < np.mean(errors) < 1.25 * high


def test_an_offset_of_all_disparities_shows_in_its_gradient() -> None:
    rng = np.random.default_rng(6)
    gradient = information = 0.0
    for _ in range(30):
        points = _points(200, rng)
        before, seen = project(RIG, points), project(RIG, move(TRUE, points))
        before[:, 2] -= 0.2  # both pairs of the camera err alike
        seen[:, 2] -= 0.2
        before += 0.05 * rng.standard_normal((200, 3))
        seen += 0.05 * rng.standard_normal((200, 3))
        guessed, spread = triangulate(RIG, before, NOISE)
        fit = fit_motion(RIG, guessed, spread, seen, NOISE, TRUE)
        gradient += fit.offset_px[0]
        information += fit.offset_px[1]
    assert gradient / information == pytest.approx(0.2, abs=0.05)
