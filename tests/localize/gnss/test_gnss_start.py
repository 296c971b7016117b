import math

import numpy as np
import pytest

from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.localize.gnss.start import GnssStart
from polemap.vehicle.motion import move_along_arc
from polemap.vehicle.pose import wrap_angle


def drive(start, antenna, *, noise_m, seed=0, seconds=40, speed=5.0, rate=0.05, outlier=None):
    """True rear-axle poses, and what the start says at each fix."""
    rng = np.random.default_rng(seed)
    found = GnssStart(GnssReceiver(tuple(antenna)), yaw_sd_max_rad=0.2)
    pose, answers = np.array(start, dtype=float), []
    for step in range(seconds * 10):
        found.add_odometry(step * 0.1, speed, rate)
        if step % 10 == 0:
            c, s = math.cos(pose[2]), math.sin(pose[2])
            x = pose[0] + c * antenna[0] - s * antenna[1] + rng.normal(0, noise_m)
            y = pose[1] + s * antenna[0] + c * antenna[1] + rng.normal(0, noise_m)
            if outlier == step:
                x += 100.0
            found.add_fix(step * 0.1, x, y, max(noise_m, 0.5))
            answers.append((pose.copy(), found.pose_at_fix()))
        pose = move_along_arc(pose, speed * 0.1, rate * 0.1)
    return answers


def test_without_noise_the_pose_is_found_exactly_antenna_and_all():
    true, answer = drive([100.0, -50.0, 2.5], [1.5, 0.4], noise_m=0.0)[-1]
    pose, _ = answer
    assert pose == pytest.approx(tuple(true), abs=1e-6)


def test_a_car_that_stands_has_no_heading():
    answers = drive([0.0, 0.0, 1.0], [0.0, 0.0], noise_m=1.0, speed=0.0, rate=0.0)
    assert all(answer is None for _, answer in answers)


@pytest.mark.parametrize("seed", range(5))
def test_the_heading_is_as_good_as_it_says(seed):
    answers = drive([0.0, 0.0, -2.0], [0.0, 0.0], noise_m=1.0, seed=seed)
    first = next((true, answer) for true, answer in answers if answer is not None)
    true, (pose, upper) = first
    assert math.sqrt(upper[5]) <= 0.2
    assert abs(wrap_angle(pose[2] - true[2])) < 4 * math.sqrt(upper[5])
    assert math.hypot(pose[0] - true[0], pose[1] - true[1]) < 4 * math.sqrt(upper[0] + upper[3])


def test_one_wild_fix_does_not_turn_the_heading():
    true, answer = drive([0.0, 0.0, 0.5], [0.0, 0.0], noise_m=0.5, outlier=200)[-1]
    pose, _ = answer
    assert abs(wrap_angle(pose[2] - true[2])) < 0.1
    assert math.hypot(pose[0] - true[0], pose[1] - true[1]) < 3.0
