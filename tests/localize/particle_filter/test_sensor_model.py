"""The sensor model: the kernel against plain numpy, and by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.drivelog.detections import Detections, VisibleRegion, pole_detections
from polemap.drivelog.frames import EarthFrame
from polemap.localize.config import LocalizeConfig
from polemap.localize.particle_filter import assignment
from polemap.localize.particle_filter.landmarks import Landmarks
from polemap.localize.particle_filter.sensor_model import PoleModel, pole_log_likelihood
from polemap.map.pole_map import PoleMap

MODEL = PoleModel.of(LocalizeConfig())
needs_kernel = pytest.mark.skipif(
    not assignment.HAVE_KERNEL, reason="the assignment kernel was not built here"
)


def pole_map(points: np.ndarray, rng: np.random.Generator) -> PoleMap:
    n = len(points)
    return PoleMap(
        frame=EarthFrame("local", name="test"),
        ids=np.arange(n),
        points_m=points,
        covariance_m2=np.tile(np.eye(2) * 0.01, (n, 1, 1)),
        width_m=np.where(rng.random(n) < 0.2, np.nan, rng.uniform(0.1, 0.5, n)),
        height_m=np.full(n, np.nan),
        observations=np.ones(n, dtype=np.int64),
        drives=np.ones(n, dtype=np.int64),
        existence=rng.uniform(0.3, 1.0, n),
    )


def scan_of(points: np.ndarray, rng: np.random.Generator) -> Detections:
    n = len(points)
    half = rng.normal(0.0, 0.2, (n, 2, 2))
    return pole_detections(
        stamp_s=0.0,
        arrival_s=0.0,
        points_vehicle_m=points,
        covariance_m2=half @ np.swapaxes(half, 1, 2) + 0.01 * np.eye(2),
        width_m=np.where(rng.random(n) < 0.2, np.nan, rng.uniform(0.1, 0.5, n)),
        track_id=np.arange(n),
        probability=rng.uniform(0.2, 1.0, n),
    )


@needs_kernel
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("with_view", [False, True])
def test_kernel_likelihood_equals_the_plain_one(seed: int, with_view: bool) -> None:
    rng = np.random.default_rng(seed)
    # of scattered poses a block has more landmarks near than it has bits for
    count, spread_m = (110, 12.0) if seed == 5 else (40, 1.0)
    landmarks = Landmarks.of(pole_map(rng.uniform([-10, -25], [45, 25], (count, 2)), rng), 0.7)
    near = landmarks.points_m[rng.choice(count, 9, replace=False)]
    scan = scan_of(np.vstack([near, near[:2] + 0.3]) + rng.normal(0, 0.15, (11, 2)), rng)
    poses = rng.normal(0, [1.0, 1.0, 0.1], (150, 3))
    poses[:75] *= spread_m
    view = VisibleRegion(np.array([1.5, 0.3]), -0.7, 0.8, 2.0, rng.uniform(15, 40, 25))
    keywords = {"view": view if with_view else None, "want_assignment": True}
    model = replace(MODEL, beta_p=0.8)
    fast = pole_log_likelihood(poses, scan, landmarks, model, backend="native", **keywords)
    plain = pole_log_likelihood(poses, scan, landmarks, model, backend="scipy", **keywords)
    threaded = pole_log_likelihood(
        poses, scan, landmarks, model, backend="native", threads=3, **keywords
    )
    np.testing.assert_allclose(fast.log_likelihood, plain.log_likelihood, atol=1e-9)
    np.testing.assert_allclose(fast.log_fit, plain.log_fit, atol=1e-9)
    np.testing.assert_allclose(fast.expected, plain.expected, atol=1e-9)
    np.testing.assert_array_equal(fast.assignment, plain.assignment)
    np.testing.assert_array_equal(fast.matched, (fast.assignment >= 0).sum(axis=1))
    np.testing.assert_array_equal(fast.log_likelihood, threaded.log_likelihood)
    # without the assignment most poses need none: their poles want different landmarks
    short = pole_log_likelihood(poses, scan, landmarks, model, view=keywords["view"])
    for name in ("log_likelihood", "log_fit", "expected", "matched"):
        np.testing.assert_array_equal(getattr(short, name), getattr(fast, name))
    assert fast.matched.max() >= 5
    assert (fast.expected.max() > 0) == with_view


@pytest.mark.parametrize("backend", ["scipy", pytest.param("native", marks=needs_kernel)])
def test_moving_world_and_poses_together_changes_nothing(backend: str) -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform([0, -10], [25, 10], (12, 2))
    world = pole_map(points, rng)
    scan = scan_of(points[:6] + rng.normal(0, 0.1, (6, 2)), rng)
    poses = rng.normal(0, [0.3, 0.3, 0.03], (20, 3))
    angle, shift = 2.1, np.array([396_000.0, 5_820_000.0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = PoleMap(
        world.frame,
        world.ids,
        world.points_m @ turn.T + shift,
        turn @ world.covariance_m2 @ turn.T,
        world.width_m,
        world.height_m,
        world.observations,
        world.drives,
        world.existence,
    )
    there = poses.copy()
    there[:, :2] = poses[:, :2] @ turn.T + shift
    there[:, 2] += angle
    view = VisibleRegion(np.zeros(2), -0.6, 0.6, 1.0, np.full(4, 24.0))
    a = pole_log_likelihood(
        poses, scan, Landmarks.of(world, 0.7), MODEL, view=view, backend=backend
    )
    b = pole_log_likelihood(
        there, scan, Landmarks.of(moved, 0.7), MODEL, view=view, backend=backend
    )
    np.testing.assert_allclose(a.log_likelihood, b.log_likelihood, atol=1e-5)


@pytest.mark.parametrize("backend", ["scipy", pytest.param("native", marks=needs_kernel)])
def test_one_pole_and_one_landmark_by_hand(backend: str) -> None:
    """Equations (7) and (8) for the smallest case, written out."""
    rng = np.random.default_rng(0)
    world = pole_map(np.array([[10.0, 0.0]]), rng)
    object.__setattr__(world, "width_m", np.array([0.3]))
    object.__setattr__(world, "existence", np.array([1.0]))
    scan = pole_detections(
        0.0,
        0.0,
        np.array([[10.2, 0.1]]),
        np.array([[[0.04, 0.0], [0.0, 0.01]]]),
        width_m=np.array([0.35]),
    )
    model = PoleModel(
        beta_p=0.5,
        width_sd_m=0.1,
        clutter_per_m2=1e-3,
        clutter_width_span_m=1.0,
        position_floor_m=0.0,
    )
    view = VisibleRegion(np.zeros(2), -1.0, 1.0, 0.0, np.array([20.0]))
    s_x, s_y = 0.04 + 0.01, 0.01 + 0.01
    position = 0.5 / (2 * np.pi * np.sqrt(s_x * s_y)) * np.exp(-0.25 * (0.04 / s_x + 0.01 / s_y))
    width = np.exp(-0.5 * 0.25) / np.sqrt(2 * np.pi) / 0.1
    expected = np.log(0.6 * position * width / 1e-3)
    found = pole_log_likelihood(
        np.zeros((1, 3)), scan, Landmarks.of(world, 0.6), model, view=view, backend=backend
    )
    assert found.log_likelihood[0] == pytest.approx(expected, abs=1e-9)
    assert found.matched[0] == 1
    # far away the landmark is missed and the pole is clutter, at a quarter of the squared range
    away = np.array([[0.0, 0.0, 0.0]])
    empty = pole_detections(0.0, 0.0, np.empty((0, 2)), np.empty((0, 2, 2)))
    missed = pole_log_likelihood(
        away, empty, Landmarks.of(world, 0.6), model, view=view, backend=backend
    )
    assert missed.log_likelihood[0] == pytest.approx(0.75 * np.log(0.4), abs=1e-9)
    assert missed.matched[0] == 0


@pytest.mark.parametrize("backend", ["scipy", pytest.param("native", marks=needs_kernel)])
def test_positions_that_are_not_finite_are_refused(backend: str) -> None:
    rng = np.random.default_rng(0)
    landmarks = Landmarks.of(pole_map(rng.normal(size=(3, 2)), rng), 0.7)
    poses = np.zeros((2, 3))
    poses[1, 0] = np.nan
    with pytest.raises(ValueError, match="poses holds a value that is not finite"):
        pole_log_likelihood(poses, scan_of(np.ones((1, 2)), rng), landmarks, MODEL, backend=backend)
    with pytest.raises(ValueError, match="points holds a value that is not finite"):
        pole_log_likelihood(
            np.zeros((1, 3)),
            scan_of(np.full((1, 2), np.inf), rng),
            landmarks,
            MODEL,
            backend=backend,
        )


@pytest.mark.parametrize("backend", ["scipy", pytest.param("native", marks=needs_kernel)])
def test_empty_map_and_empty_scan_say_nothing(backend: str) -> None:
    rng = np.random.default_rng(0)
    nothing = Landmarks.of(pole_map(np.empty((0, 2)), rng), 0.7)
    found = pole_log_likelihood(
        np.zeros((5, 3)), scan_of(np.ones((2, 2)), rng), nothing, MODEL, backend=backend
    )
    np.testing.assert_array_equal(found.log_likelihood, np.zeros(5))
    np.testing.assert_array_equal(found.matched, np.zeros(5))


def test_some_landmarks_are_rows_of_all() -> None:
    rng = np.random.default_rng(4)
    world = pole_map(rng.normal(size=(9, 2)), rng)
    rows = np.array([1, 4, 8])
    some, every = Landmarks.of(world, 0.7, rows), Landmarks.of(world, 0.7)
    for name in ("points_m", "covariance_m2", "width_m", "detection", "ids"):
        np.testing.assert_array_equal(getattr(some, name), getattr(every, name)[rows])
    assert (len(some), len(every)) == (3, 9)
