import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.vehicle.pose import Pose2D, shift_forward, wrap_angle

coordinate = st.floats(-1e3, 1e3)
angle = st.floats(-50.0, 50.0)
poses = st.builds(Pose2D, coordinate, coordinate, st.floats(-math.pi, math.pi - 1e-9))


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
def test_compose_then_undo_gives_the_pose_back(a, b):
    back = a.inverse().compose(a.compose(b))
    assert back.x_m == pytest.approx(b.x_m, abs=1e-8)
    assert back.y_m == pytest.approx(b.y_m, abs=1e-8)
    assert wrap_angle(back.yaw_rad - b.yaw_rad) == pytest.approx(0.0, abs=1e-9)


@given(poses, poses, coordinate, coordinate)
def test_composing_poses_is_transforming_points_twice(a, b, x, y):
    point = np.array([[x, y]])
    assert np.allclose(a.compose(b).transform(point), a.transform(b.transform(point)), atol=1e-8)


@given(poses, st.floats(-5.0, 5.0))
def test_moving_the_reference_point_is_composing_with_an_offset_ahead(pose, distance):
    moved = shift_forward(pose.as_array(), distance)
    assert np.allclose(moved[:2], pose.compose(Pose2D(distance, 0.0, 0.0)).as_array()[:2])
    assert np.allclose(shift_forward(moved, -distance), pose.as_array(), atol=1e-9)


def test_moving_the_reference_point_leaves_the_input_alone():
    many = np.zeros((4, 3))
    shift_forward(many, 2.0)
    assert not many.any()
