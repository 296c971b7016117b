import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.vehicle.pose import (
    Pose2D,
    compose,
    inverse,
    inverse_transform_points,
    move_reference_point,
    pose_rotation,
    reference_point_jacobian,
    relative,
    rigid_fit,
    rotate,
    rotate_back,
    rotate_covariance,
    rotation,
    transform_points,
    wrap_angle,
)

coordinate = st.floats(-1e3, 1e3)
angle = st.floats(-50.0, 50.0)
poses = st.builds(
    lambda *row: np.array(row), coordinate, coordinate, st.floats(-math.pi, math.pi - 1e-9)
)


def covariance(seed, size=3):
    root = np.random.default_rng(seed).normal(size=(size, size))
    return root @ root.T + 0.01 * np.eye(size)


@given(angle)
def test_a_wrapped_angle_lies_in_the_half_open_circle_and_keeps_its_direction(value):
    wrapped = wrap_angle(value)
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(value), abs=1e-12)
    assert math.sin(wrapped) == pytest.approx(math.sin(value), abs=1e-12)


def test_half_a_turn_wraps_to_minus_pi_for_scalars_and_arrays():
    assert wrap_angle(math.pi) == -math.pi
    assert np.array_equal(wrap_angle(np.array([math.pi, 3 * math.pi])), [-math.pi, -math.pi])


@given(poses, poses)
def test_composing_and_relating_undo_each_other(a, b):
    assert np.allclose(relative(a, compose(a, b)), b, atol=1e-8)
    assert np.allclose(compose(inverse(a), compose(a, b)), b, atol=1e-8)
    assert np.allclose(compose(a, relative(a, b)), b, atol=1e-8)
    assert np.allclose(inverse(inverse(a)), a, atol=1e-8)


@given(poses, poses, coordinate, coordinate)
def test_composing_poses_is_transforming_points_twice(a, b, x, y):
    point = np.array([[x, y]])
    once, twice = transform_points(compose(a, b), point), transform_points(b, point)
    assert np.allclose(once, transform_points(a, twice), atol=1e-8)


def test_turns_add_up_without_wrapping():
    assert compose([0.0, 0.0, 3.0], [0.0, 0.0, 3.0])[2] == 6.0
    assert relative([0.0, 0.0, -3.0], [0.0, 0.0, 3.0])[2] == 6.0


@given(poses, st.integers(1, 5))
def test_points_go_and_come_back_by_one_pose_and_by_many(pose, count):
    points = np.random.default_rng(count).normal(0.0, 20.0, (count, 2))
    there = transform_points(pose, points)
    assert np.allclose(inverse_transform_points(pose, there), points, atol=1e-8)
    many = np.tile(pose, (count, 1))
    assert np.allclose(transform_points(many, points), there, atol=1e-8)
    assert np.allclose(inverse_transform_points(many, there), points, atol=1e-8)
    assert transform_points(many[:, np.newaxis], points).shape == (count, count, 2)


@given(coordinate, coordinate, angle)
def test_rotating_is_the_product_with_the_matrix_and_goes_back(x, y, yaw):
    turned = rotate([x, y], yaw)
    assert np.allclose(turned, rotation(yaw) @ [x, y], atol=1e-9)
    assert np.allclose(rotate_back(turned, yaw), [x, y], atol=1e-9)
    assert np.allclose(pose_rotation(yaw) @ [x, y, 0.5], [*turned, 0.5], atol=1e-9)


def test_functions_take_leading_dimensions_and_rows_with_names():
    rows = np.random.default_rng(3).normal(size=(4, 5, 3))
    assert rotation(rows[..., 2]).shape == (4, 5, 2, 2)
    assert pose_rotation(rows[..., 2]).shape == (4, 5, 3, 3)
    assert np.allclose(compose(rows, rows)[2, 3], compose(rows[2, 3], rows[2, 3]))
    assert np.allclose(compose(rows[0, 0], rows)[2, 3], compose(rows[0, 0], rows[2, 3]))
    assert np.allclose(inverse(rows)[2, 3], inverse(rows[2, 3]))
    named = Pose2D(1.0, 2.0, 0.3)
    assert np.array_equal(compose(named, named), compose(np.array(named), np.array(named)))


@given(poses, st.floats(-5.0, 5.0), st.floats(-3.0, 3.0))
def test_moving_the_reference_point_is_composing_with_an_offset(pose, ahead, left):
    moved = move_reference_point(pose, ahead, left)
    assert np.allclose(moved, compose(pose, [ahead, left, 0.0]))
    assert np.allclose(move_reference_point(moved, -ahead, -left), pose, atol=1e-9)
    steps = 1e-6 * np.eye(3)
    numeric = [
        (move_reference_point(pose + h, ahead, left) - move_reference_point(pose - h, ahead, left))
        / 2e-6
        for h in steps
    ]
    jacobian = reference_point_jacobian(pose[2], ahead, left)
    assert np.allclose(jacobian, np.stack(numeric, axis=1), atol=1e-5)


def test_moving_the_reference_point_leaves_the_input_alone():
    many = np.zeros((4, 3))
    move_reference_point(many, 2.0)
    assert not many.any()


@given(angle, st.integers(0, 1000))
def test_turned_covariances_are_those_of_turned_vectors(yaw, seed):
    plane, pose = covariance(seed, 2), covariance(seed)
    turn = rotation(yaw)
    assert np.allclose(rotate_covariance(plane, yaw), turn @ plane @ turn.T)
    turned = rotate_covariance(pose, yaw)
    assert np.allclose(turned[:2, :2], turn @ pose[:2, :2] @ turn.T)
    assert np.allclose(turned[:2, 2], turn @ pose[:2, 2])
    assert turned[2, 2] == pytest.approx(pose[2, 2])


@given(poses, st.integers(2, 12), st.integers(0, 1000))
def test_a_fit_of_moved_points_is_the_motion(pose, count, seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(0.0, 10.0, (count, 2))
    for weights in (None, rng.uniform(0.1, 2.0, count)):
        fit = rigid_fit(points, transform_points(pose, points), weights)
        assert np.allclose(fit[:2], pose[:2], atol=1e-6)
        assert wrap_angle(fit[2] - pose[2]) == pytest.approx(0.0, abs=1e-7)


def test_no_other_pose_fits_noisy_points_better_than_the_fit():
    rng = np.random.default_rng(7)
    points, weights = rng.normal(0.0, 10.0, (8, 2)), rng.uniform(0.1, 2.0, 8)
    wanted = transform_points([3.0, 4.0, 2.0], points) + rng.normal(0.0, 0.5, (8, 2))
    for given_weights in (None, weights):
        fit = rigid_fit(points, wanted, given_weights)

        def cost(pose, w=given_weights):
            squares = ((transform_points(pose, points) - wanted) ** 2).sum(axis=1)
            return float(squares.sum() if w is None else w @ squares)

        for offset in 1e-3 * np.vstack([np.eye(3), -np.eye(3)]):
            assert cost(fit + offset) > cost(fit)


def test_many_fits_at_once_equal_single_ones_and_one_place_has_no_yaw():
    rng = np.random.default_rng(8)
    one, two, w = rng.normal(size=(5, 4, 2)), rng.normal(size=(5, 4, 2)), rng.uniform(1, 2, 4)
    for weights in (None, w):
        many = rigid_fit(one, two, weights)
        single = [rigid_fit(a, b, weights) for a, b in zip(one, two, strict=True)]
        assert np.allclose(many, single)
    assert np.array_equal(rigid_fit([[1.0, 2.0]], [[5.0, 5.0]]), [4.0, 3.0, 0.0])
