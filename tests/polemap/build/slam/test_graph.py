"""The graph against scipy's least squares, and its factors against finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from polemap.build.slam.graph import Graph
from polemap.build.slam.motion import MotionNoise, dead_reckon, increments, keyframe_stamps
from polemap.build.slam.problem import Problem
from polemap.drivelog.streams import OdometryStream
from polemap.vehicle.pose import inverse_transform_points, relative, transform_points, wrap_angle

pytest.importorskip("gtsam")
Floats = NDArray[np.float64]
SD = np.array([0.05, 0.05, 0.005, 0.002, 0.02, 0.004])


def stream(rng: np.random.Generator, n: int = 400) -> OdometryStream:
    stamps = 0.05 * np.arange(n)
    speed = 5.0 + np.sin(0.3 * stamps)
    rate = 0.25 * np.sin(0.4 * stamps)
    return OdometryStream(stamps, stamps, speed + 0.02 * rng.standard_normal(n), rate)


def small(rng: np.random.Generator) -> tuple[Problem, Floats]:
    """A drive of twelve poses along ten landmarks, its odometry off by a known calibration."""
    odometry = stream(rng)
    stamps = keyframe_stamps(dead_reckon(odometry, np.zeros(6), MotionNoise()), 8.0)
    truth = np.array([0.03, 0.0, 0.002, 0.001, 0.01, 0.0])
    poses = dead_reckon(odometry, truth, MotionNoise()).at(stamps)
    path, steps = increments(odometry, np.zeros(6), MotionNoise(), stamps)
    points = poses[rng.integers(0, len(poses), 10), :2] + rng.uniform(-9.0, 9.0, (10, 2))
    pose, point = np.meshgrid(np.arange(len(poses)), np.arange(10), indexing="ij")
    near = np.hypot(*(poses[pose.ravel(), :2] - points[point.ravel()]).T) < 25.0
    seen_from, seen = pose.ravel()[near], point.ravel()[near]
    seen_m = inverse_transform_points(poses[seen_from], points[seen])
    seen_m = seen_m + 0.03 * rng.standard_normal(seen_m.shape)
    fixed = np.arange(0, len(poses), 3)
    n, c = len(poses), len(fixed)
    problem = Problem(
        poses=path.at(stamps),
        points_m=points + 0.5 * rng.standard_normal(points.shape),
        calibration=np.zeros((1, 6)),
        calibration_walk=np.zeros(1, dtype=np.bool_),
        motion_from=np.arange(n - 1),
        motion_calibration=np.zeros(n - 1, dtype=np.int64),
        motion=steps.motion,
        motion_jacobian=steps.jacobian,
        motion_covariance=steps.covariance,
        seen_from=seen_from,
        seen=seen,
        seen_m=seen_m,
        seen_covariance_m2=np.broadcast_to(0.04**2 * np.eye(2), (len(seen), 2, 2)),
        fix_from=fixed,
        fix_bias=np.arange(c),
        fix_m=poses[fixed, :2] + [0.3, -0.2],
        fix_antenna_m=np.zeros((c, 2)),
        fix_sd_m=np.full(c, 0.5),
        bias_sd_m=np.full(c, 1.0),
        bias_share=np.where(np.arange(c) > 0, 0.8, 0.0),
        link=np.empty((0, 2), dtype=np.int64),
        link_sd_m=np.empty(0),
        origin=np.empty(0, dtype=np.int64),
    )
    return problem, poses


def residuals(problem: Problem, flat: Floats) -> Floats:
    """All residuals in their deviations, as the module of the graph states them."""
    p = problem
    n, m, c = len(p.poses), len(p.points_m), len(p.fix_from)
    poses = flat[: 3 * n].reshape(n, 3)
    points = flat[3 * n : 3 * n + 2 * m].reshape(m, 2)
    bias = flat[3 * n + 2 * m : 3 * n + 2 * m + 2 * c].reshape(c, 2)
    calibration = flat[-6:]
    off = relative(poses[:-1], poses[1:]) - p.motion - p.motion_jacobian @ calibration
    off[:, 2] = wrap_angle(off[:, 2])
    motion = np.linalg.solve(np.linalg.cholesky(p.motion_covariance), off[..., None])
    seen = transform_points(poses[p.seen_from], p.seen_m) - points[p.seen]
    fix = (poses[p.fix_from, :2] + bias - p.fix_m) / p.fix_sd_m[:, None]
    share = p.bias_share[1:, None]
    walk = (bias[1:] - share * bias[:-1]) / np.sqrt(1.0 - share**2)
    start = (flat[:3] - p.poses[0]) / [1e3, 1e3, 3.0]
    return np.concatenate(
        [motion.ravel(), seen.ravel() / 0.04, fix.ravel(), bias[0], walk.ravel(),
         calibration / SD, start]
    )  # fmt: skip


def test_the_graph_is_solved_as_by_scipy() -> None:
    problem, _ = small(np.random.default_rng(1))
    solution = Graph(problem, (SD, 0.1)).solve(60)
    start = np.concatenate(
        [problem.poses.ravel(), problem.points_m.ravel(), np.zeros(2 * len(problem.fix_from) + 6)]
    )
    oracle = least_squares(lambda flat: residuals(problem, flat), start, x_scale="jac")
    n = len(problem.poses)
    # kernels take a little weight from the largest residuals, which the oracle lacks
    np.testing.assert_allclose(
        solution.poses[:, :2], oracle.x[: 3 * n].reshape(n, 3)[:, :2], atol=0.08
    )
    np.testing.assert_allclose(solution.calibration[0], oracle.x[-6:], atol=0.004)


def test_covariance_is_that_of_the_oracle() -> None:
    problem, _ = small(np.random.default_rng(2))
    graph = Graph(problem, (SD, 0.1))
    solution = graph.solve(60)
    flat = np.concatenate(
        [solution.poses.ravel(), solution.points_m.ravel(), solution.bias_m.ravel(),
         solution.calibration.ravel()]
    )  # fmt: skip
    step = 1e-6
    columns = [
        (residuals(problem, flat + step * unit) - residuals(problem, flat - step * unit))
        / (2.0 * step)
        for unit in np.eye(len(flat))
    ]
    jacobian = np.stack(columns, axis=1)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    n = len(problem.poses)
    chosen = np.array([n - 1, 2])
    found = graph.covariance(chosen, np.array([4, 1]))
    rows = np.concatenate([np.arange(3 * k, 3 * k + 3) for k in chosen])
    rows = np.concatenate([rows, *(3 * n + 2 * k + np.arange(2) for k in (4, 1))])
    # the kernels' weights are about one: deviations within a fifth
    ratio = np.sqrt(np.diag(found) / np.diag(covariance)[rows])
    assert ((ratio > 0.8) & (ratio < 1.25)).all()
    np.testing.assert_allclose(graph.landmark_covariance(np.array([4]))[0], found[6:8, 6:8])


def test_a_link_between_two_poles_is_given_up_and_bends_nothing() -> None:
    problem, _ = small(np.random.default_rng(3))
    gap = np.hypot(*(problem.points_m[:, None] - problem.points_m[None]).transpose(2, 0, 1))
    first, second = np.unravel_index(int(np.argmax(gap)), gap.shape)
    wrong = replace(problem, link=np.array([[first, second]]), link_sd_m=np.array([0.06]))
    plain = Graph(problem, (SD, 0.1)).solve(40)
    solution = Graph(wrong, (SD, 0.1)).solve(40)
    assert solution.link_weight[0] < 0.01
    np.testing.assert_allclose(solution.poses, plain.poses, atol=0.05)


def test_increments_follow_their_calibration() -> None:
    odometry = stream(np.random.default_rng(4))
    stamps = np.linspace(0.0, 19.0, 12)
    _, about = increments(odometry, np.zeros(6), MotionNoise(), stamps)
    change = np.array([0.01, -0.02, 0.002, 0.001, 0.01, 0.002])
    _, there = increments(odometry, change, MotionNoise(), stamps)
    np.testing.assert_allclose(about.motion + about.jacobian @ change, there.motion, atol=0.01)
    assert (np.linalg.eigvalsh(about.covariance) > 0.0).all()
