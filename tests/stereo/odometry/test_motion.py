"""Motion from points: exact without noise, consistent with it, blind to what moves by itself."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from polemap.stereo.odometry.disparity_error import TERMS, DisparityError
from polemap.stereo.odometry.motion import MotionFit, fit_motion, inverse_symmetric
from polemap.stereo.odometry.sights import (
    by_motion,
    by_point,
    by_sight,
    move,
    points_of,
    project,
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


def _fit(before: Floats, seen: Floats, guess: Floats = TRUE) -> MotionFit:
    spreads = np.tile(NOISE, (len(before), 1, 1))
    return fit_motion(RIG, before, spreads, seen, NOISE, guess)


def test_exact_sights_give_the_exact_motion_from_no_guess() -> None:
    points = _points(60, np.random.default_rng(1))
    fit = _fit(project(RIG, points), project(RIG, move(TRUE, points)), np.eye(4))
    assert fit.inliers.all()
    assert fit.current_from_previous == pytest.approx(TRUE, abs=1e-4)


def test_the_jacobians_are_the_derivatives() -> None:
    points = _points(5, np.random.default_rng(2))
    sights, step = project(RIG, points), 1e-6
    for axis in range(3):
        aside = step * np.eye(3)[axis]
        slope = (project(RIG, points + aside) - project(RIG, points - aside)) / (2 * step)
        assert by_point(RIG, points)[:, :, axis] == pytest.approx(slope, rel=1e-4, abs=1e-4)
        slope = (points_of(RIG, sights + aside) - points_of(RIG, sights - aside)) / (2 * step)
        assert by_sight(RIG, points)[:, :, axis] == pytest.approx(slope, rel=1e-4, abs=1e-4)
    for axis in range(6):
        ahead, behind = (
            move(_transform(tuple(change[:3]), tuple(change[3:])), points)
            for change in (step * np.eye(6)[axis], -step * np.eye(6)[axis])
        )
        slope = (project(RIG, ahead) - project(RIG, behind)) / (2 * step)
        assert by_motion(RIG, points)[:, :, axis] == pytest.approx(slope, rel=1e-4, abs=1e-3)


def test_a_point_of_a_sight_is_seen_there() -> None:
    points = _points(20, np.random.default_rng(3))
    assert points_of(RIG, project(RIG, points)) == pytest.approx(points, rel=1e-9)
    nowhere = np.array([[100.0, 100.0, 101.0]])
    assert np.isfinite(points_of(RIG, nowhere)).all()


def test_inverses_by_cofactors_are_inverses() -> None:
    half = np.random.default_rng(9).standard_normal((40, 3, 3))
    matrices = half @ np.swapaxes(half, 1, 2) + 0.1 * np.eye(3)
    assert inverse_symmetric(matrices) == pytest.approx(np.linalg.inv(matrices), rel=1e-6, abs=1e-9)


def test_noise_of_the_disparities_does_not_shorten_the_step() -> None:
    """Linearised at the noisy sights before, it would by more than a percent here."""
    rng = np.random.default_rng(8)
    steps = []
    for _ in range(60):
        u, v = rng.uniform(20, 780, 150), rng.uniform(20, 460, 150)
        points = RIG.camera_points(u, v, rng.uniform(2.0, 12.0, 150))
        before = project(RIG, points) + 0.3 * rng.standard_normal((150, 3))
        seen = project(RIG, move(TRUE, points)) + 0.3 * rng.standard_normal((150, 3))
        steps.append(_fit(before, seen).current_from_previous[2, 3])
    sd = float(np.std(steps)) / np.sqrt(len(steps))
    assert np.mean(steps) == pytest.approx(TRUE[2, 3], abs=3.3 * sd)
    assert 3.3 * sd < 0.005 * abs(TRUE[2, 3])


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
    # the step before was nearly the same, as it is in a drive
    fit = _fit(before, seen, _transform((0, 0, -0.8), (0, -0.02, 0)))
    assert np.linalg.norm(fit.current_from_previous[:3, 3] - TRUE[:3, 3]) < 0.05
    wrongly = fit.inliers[others].sum()
    assert wrongly <= 0.1 * max(len(others), 1)


def test_the_stated_covariance_is_the_spread_of_independent_corners_times_three() -> None:
    """The factor stands for corners that err alike; these here do not."""
    rng = np.random.default_rng(5)
    errors = []
    for _ in range(200):
        points = _points(80, rng)
        before = project(RIG, points) + 0.3 * rng.standard_normal((80, 3))
        seen = project(RIG, move(TRUE, points)) + 0.3 * rng.standard_normal((80, 3))
        fit = _fit(before, seen)
        difference = fit.current_from_previous @ np.linalg.inv(TRUE)
        turn = cv2.Rodrigues(difference[:3, :3])[0].ravel()
        error = np.concatenate([difference[:3, 3], turn])
        errors.append(3.0 * error @ np.linalg.solve(fit.covariance, error))
    low, high = stats.chi2.ppf([0.001, 0.999], 6 * 200) / 200
    # far points bend the covariance a little: within a quarter of the exact law
    assert 0.75 * low < np.mean(errors) < 1.25 * high


def test_points_on_one_ray_leave_the_motion_open() -> None:
    """All corners at one place determine no turn about it: no crash, and it is told."""
    before = np.tile([300.0, 200.0, 280.0], (20, 1))
    fit = _fit(before, before, np.eye(4))
    assert np.isfinite(fit.current_from_previous).all()


def test_an_error_of_the_disparities_is_learned_from_motion() -> None:
    """Both pairs of every step have it, and points that are known come from such pairs."""
    rng = np.random.default_rng(6)
    field = np.array([0.3, 0.0, -0.2, 0.4, 0.0])
    error = DisparityError(RIG)
    scales = []
    for _ in range(60):
        points = _points(200, rng)
        pair = []
        for place in (points, move(TRUE, points)):
            sights = project(RIG, place)
            # the field says by how much disparities are too large
            sights[:, 2] -= error.terms(sights) @ field
            pair.append(error.removed(sights + 0.1 * rng.standard_normal((200, 3))))
        fit = _fit(*pair)
        by_error = np.zeros((200, 3, TERMS))
        by_error[:, 2] = error.terms(pair[0])
        error.learn(fit, by_error[fit.inliers], pair[1][fit.inliers])
        scales.append(fit.current_from_previous[2, 3] / TRUE[2, 3])
    assert error.coefficients_px == pytest.approx(field, abs=0.12)
    assert scales[0] < 0.99
    assert np.mean(scales[-20:]) == pytest.approx(1.0, abs=0.003)
