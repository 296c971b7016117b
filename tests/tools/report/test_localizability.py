"""The bound on a pose from one look at the mapped poles."""

from __future__ import annotations

import numpy as np
import pytest

from drivelog.frames import EarthFrame
from polemap.landmark_map import PoleMap
from tools.report.localizability import SensorModel, localizability
from tools.report.trajectory import Trajectory

SENSOR = SensorModel(30.0, 1.0, 1.0, 0.1, 0.001, 0.05, 0.001)


def poles(points: list[tuple[float, float]]) -> PoleMap:
    n = len(points)
    return PoleMap(
        EarthFrame("local", name="t"),
        np.arange(n),
        np.array(points, dtype=float).reshape(n, 2),
        np.repeat(0.0004 * np.eye(2)[None], n, axis=0),
        np.full(n, 0.2),
        np.full(n, 3.0),
        np.ones(n, dtype=np.int64),
        np.ones(n, dtype=np.int64),
        np.ones(n),
    )


def standing(yaw: float = 0.0) -> Trajectory:
    return Trajectory(np.array([0.0, 1.0]), np.array([[0.0, 0.0, yaw], [0.1, 0.0, yaw]]))


def test_no_pole_leaves_the_prior() -> None:
    bound = localizability(standing(), poles([(0.0, 500.0)]), SENSOR)
    assert bound.lateral_sd_m[0] == pytest.approx(10.0)
    assert bound.in_view[0] == 0


def test_more_poles_and_nearer_poles_are_better() -> None:
    few = localizability(standing(), poles([(15.0, 4.0), (18.0, -4.0)]), SENSOR)
    more = localizability(standing(), poles([(15.0, 4.0), (18.0, -4.0), (9.0, 3.0)]), SENSOR)
    far = localizability(standing(), poles([(27.0, 4.0), (29.0, -4.0)]), SENSOR)
    assert more.lateral_sd_m[0] < few.lateral_sd_m[0] < far.lateral_sd_m[0]
    assert more.longitudinal_sd_m[0] < few.longitudinal_sd_m[0] < far.longitudinal_sd_m[0]


def test_bound_equals_the_scatter_of_a_maximum_likelihood_fit() -> None:
    """Simulated looks, solved by weighted least squares: their spread is the bound."""
    rng = np.random.default_rng(0)
    points = np.array([(8.0, 4.0), (14.0, -5.0), (20.0, 6.0), (25.0, -3.0)])
    found = localizability(standing(), poles([tuple(p) for p in points]), SENSOR)
    rows, weights = [], []
    for x, y in points:
        r, angle = np.hypot(x, y), np.arctan2(y, x)
        ray = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        cov = ray @ np.diag([(0.1 + 0.001 * r * r) ** 2, (0.05 + 0.001 * r) ** 2]) @ ray.T
        weights.append(np.linalg.cholesky(cov + 0.0004 * np.eye(2)))
        rows.append([[-1.0, 0.0, y], [0.0, -1.0, -x]])
    whiten = [np.linalg.inv(w) for w in weights]
    jacobian = np.concatenate([w @ np.array(r) for w, r in zip(whiten, rows, strict=True)])
    solve = np.linalg.pinv(jacobian)
    fits = rng.standard_normal((4000, len(jacobian))) @ solve.T
    tolerance = 4.0 / np.sqrt(2 * 4000)
    # The wide prior takes a little off the bound; the heading's is the one that shows.
    assert found.longitudinal_sd_m[0] == pytest.approx(fits[:, 0].std(), rel=tolerance + 0.01)
    assert found.lateral_sd_m[0] == pytest.approx(fits[:, 1].std(), rel=tolerance + 0.01)


def test_turning_the_world_changes_nothing() -> None:
    points = np.array([(8.0, 4.0), (14.0, -5.0)])
    angle = 2.1
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    before = localizability(standing(), poles([tuple(p) for p in points]), SENSOR)
    after = localizability(standing(angle), poles([tuple(p) for p in points @ turn]), SENSOR)
    assert after.lateral_sd_m[0] == pytest.approx(before.lateral_sd_m[0])
    assert after.longitudinal_sd_m[0] == pytest.approx(before.longitudinal_sd_m[0])
