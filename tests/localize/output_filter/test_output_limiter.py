import math

import numpy as np
import pytest

from polemap.localize.output_filter.limiter import CORRECTION_MPS, CORRECTION_RADPS, OutputLimiter
from polemap.localize.output_filter.state import Counts, FilterState
from polemap.vehicle.packed import pack


def state(stamp, x=0.0, y=0.0, yaw=0.0, speed=10.0, **changes):
    mean = (x, y, yaw, speed, 0.0, 0.0, 0.0, 0.0, 0.0)
    return FilterState(stamp, mean, pack(0.01 * np.eye(9)))._replace(**changes)


def test_without_corrections_the_output_is_the_filters_pose():
    limiter = OutputLimiter()
    for tick in range(50):
        answer = limiter.limit(state(tick / 100, x=10.0 * tick / 100))
        assert answer.pose == pytest.approx((10.0 * tick / 100, 0.0, 0.0), abs=1e-9)
        assert answer.flag == ("started" if tick == 0 else "")
        assert np.allclose(answer.covariance, 0.01 * np.eye(3), atol=1e-12)


def test_a_correction_is_spread_over_ticks_and_owned_up_to():
    limiter = OutputLimiter()
    limiter.limit(state(0.0))
    poses = []
    for tick in range(1, 60):
        answer = limiter.limit(state(tick / 100, x=0.1 * tick, y=0.3, yaw=0.1))
        poses.append(answer.pose)
        rest = np.array([0.1 * tick, 0.3, 0.1]) - answer.pose
        assert np.allclose(answer.covariance, 0.01 * np.eye(3) + np.outer(rest, rest))
    lateral = np.array(poses)[:, 1]
    yaw = np.array(poses)[:, 2]
    # carried along the heading, plus at most the allowed correction
    assert np.abs(np.diff(lateral)).max() <= CORRECTION_MPS / 100 + 0.1 * math.sin(0.1) + 1e-9
    assert np.abs(np.diff(yaw)).max() <= CORRECTION_RADPS / 100 + 1e-9
    assert lateral[-1] == pytest.approx(0.3, abs=1e-9)
    assert yaw[-1] == pytest.approx(0.1, abs=1e-9)


@pytest.mark.parametrize("kind", ["reinitializations", "takeovers", "gnss_restarts"])
def test_a_declared_jump_is_taken_at_once_and_flagged(kind):
    limiter = OutputLimiter()
    limiter.limit(state(0.0))
    answer = limiter.limit(state(0.01, x=0.1, y=5.0, counts=Counts(**{kind: 1})))
    assert answer.flag == "reinitialized"
    assert answer.pose[1] == 5.0
    assert answer.jump_m == pytest.approx(5.0)
    following = limiter.limit(state(0.02, x=0.2, y=5.0, counts=Counts(**{kind: 1})))
    assert following.flag == ""


def test_the_correction_goes_the_short_way_round():
    limiter = OutputLimiter()
    limiter.limit(state(0.0, yaw=math.pi - 0.001))
    answer = limiter.limit(state(0.01, x=-0.1, yaw=-math.pi + 0.001))
    assert abs(abs(answer.pose[2]) - math.pi) < 0.0011


def test_asking_without_the_limit_leaves_the_limiter_alone():
    limiter = OutputLimiter()
    limiter.limit(state(0.0))
    assert limiter.unlimited(state(0.5, y=9.0)).pose[1] == 9.0
    assert limiter.last_stamp_s == 0.0


def test_what_is_metres_off_is_no_correction_but_a_return_and_says_so():
    limiter = OutputLimiter()
    limiter.limit(state(0.0))
    near = limiter.limit(state(0.01, x=0.1, y=0.9))
    assert near.flag == ""
    back = limiter.limit(state(0.02, x=0.2, y=14.0))
    assert back.flag == "recovered"
    assert back.pose == (0.2, 14.0, 0.0)
    assert back.jump_m == pytest.approx(14.0, abs=0.1)
    assert np.allclose(back.covariance, 0.01 * np.eye(3))


@pytest.mark.parametrize("counts", [Counts(), Counts(reinitializations=1)])
def test_with_a_larger_bound_the_output_comes_back_without_a_step(counts):
    limiter = OutputLimiter(step_beyond_m=10.0)
    limiter.limit(state(0.0))
    last, said = 0.0, 0.0
    for tick in range(1, 400):
        answer = limiter.limit(state(tick / 100, x=0.1 * tick, y=4.0, counts=counts))
        assert answer.flag == ""
        assert 0.0 <= answer.pose[1] - last <= CORRECTION_MPS / 100 + 1e-9
        last = answer.pose[1]
        # what is outstanding is stated, so that it lies within one deviation
        said = math.sqrt(answer.covariance[1, 1])
        assert abs(4.0 - last) <= said
    assert last == pytest.approx(4.0)
    beyond = limiter.limit(state(4.0, x=40.0, y=15.0, counts=counts))
    assert (beyond.flag, beyond.pose[1]) == ("recovered", 15.0)
    anew = limiter.limit(
        state(4.01, x=40.1, y=30.0, counts=Counts(reinitializations=counts.reinitializations + 1))
    )
    assert anew.flag == "reinitialized"
