import math
from itertools import pairwise

import numpy as np
import pytest

from polemap.localize.output_filter.config import OutputConfig
from polemap.localize.output_filter.failed_gate import INFLATE_AFTER_S
from polemap.localize.output_filter.filter import OutputFilter
from polemap.localize.output_filter.noise_model import NoiseModel
from polemap.localize.output_filter.odometry_update import REJECTIONS_MAX
from polemap.vehicle.kalman import chi_square_gate
from polemap.vehicle.packed import unpack
from tests.localize.output_events import started_with_odometry

START = np.diag([0.04, 0.04, 0.01])


def rejections(config, offsets, *, gnss=None):
    """Poses off by the given lateral offsets at 20 Hz after two good seconds; the decisions."""
    output = started_with_odometry(config, 0.02)
    decisions, stamp = [], 0.0
    for step in range(1, 40 + len(offsets)):
        stamp = 0.05 * step
        for part in range(3):
            output.add_odometry(stamp - 0.05 + 0.05 * (part + 1) / 3, 10.0, 0.0)
        offset = 0.0 if step < 40 else offsets[step - 40]
        output.add_pose(
            stamp + 1e-6, np.array([10.0 * stamp, offset, 0.0]), np.diag([0.0025, 0.0025, 1e-5])
        )
        decisions.append(output.newest.decision)
        if gnss is not None and step % 10 == 0:
            output.add_gnss(stamp + 2e-6, 10.0 * stamp + 1.0, gnss, 1.0)
    return output, decisions[39:]


def test_rejections_are_ignored_then_inflated_then_reinitialize():
    config = OutputConfig()
    output, decisions = rejections(config, [10.0] * 60)
    changes = [decisions[0]] + [b for a, b in pairwise(decisions) if a != b]
    assert changes == ["ignored", "inflated", "reinitialized", "accepted"]
    assert decisions.index("inflated") * 0.05 == pytest.approx(INFLATE_AFTER_S, abs=0.051)
    counts = output.newest.counts
    assert decisions.index("reinitialized") * 0.05 == pytest.approx(
        config.reinitialize_after_s, abs=0.051
    )
    assert counts.reinitializations == 1
    assert counts.gate_rejections == decisions.index("accepted")
    assert counts.inflations == decisions.count("inflated")
    assert output.newest.mean[1] == pytest.approx(10.0, abs=0.2)


def test_poses_that_come_back_end_the_rejections_without_a_jump():
    output, decisions = rejections(OutputConfig(), [10.0] * 20 + [0.0] * 20)
    assert "reinitialized" not in decisions
    assert decisions[-1] == "accepted"
    assert abs(output.newest.mean[1]) < 0.05
    assert output.newest.rival is None


def test_poses_that_do_not_move_as_the_car_does_are_no_place_to_go_to():
    """Positions beside the truth but a heading turned by 90 degrees cannot both be right."""
    config = OutputConfig()
    output = started_with_odometry(config, 2.0)
    for step in range(1, 120):
        stamp = 2.0 + 0.05 * step
        for part in range(3):
            output.add_odometry(stamp - 0.05 + 0.05 * (part + 1) / 3, 10.0, 0.0)
        turned = np.array([10.0 * stamp, 10.0, math.pi / 2])
        output.add_pose(stamp + 1e-6, turned, np.diag([0.0025, 0.0025, 1e-5]))
    counts = output.newest.counts
    assert counts.reinitializations == 0
    assert counts.incoherent > 10
    assert abs(output.newest.mean[1]) < 0.1


def test_gnss_vetoes_a_reinitialization_to_poses_that_it_contradicts():
    output, decisions = rejections(OutputConfig(), [10.0] * 100, gnss=0.5)
    assert "reinitialized" not in decisions
    assert decisions.count("vetoed") == output.newest.counts.gnss_vetoes > 0
    assert abs(output.newest.mean[1]) < 1.0


def test_gnss_that_speaks_for_the_poses_does_not_veto():
    _, decisions = rejections(OutputConfig(), [10.0] * 100, gnss=9.5)
    assert "reinitialized" in decisions


def test_inflation_is_bounded():
    config = OutputConfig(reinitialize_after_s=1e6)
    output, decisions = rejections(config, [10.0] * 200)
    assert set(decisions) == {"ignored", "inflated"}, "10 m off for 10 s never passes the gate"
    # the bound allows 1.5 m after ten seconds at 10 m/s, and dead reckoning has its own drift
    assert math.sqrt(unpack(output.newest.upper)[1, 1]) < 3.5


def test_the_gate_is_on_the_squared_distance():
    """A pose just inside the gate is accepted, one just outside is not."""
    config = OutputConfig(pose_errors="independent")
    limit = math.sqrt(chi_square_gate(config.pose_gate, 3))
    for factor, decision in ((0.99, "accepted"), (1.01, "ignored")):
        output = started_with_odometry(
            config, noise=NoiseModel(pose_floor_m=0.0, pose_floor_rad=0.0)
        )
        state = output.newest
        spread = unpack(state.upper)[1, 1] + 0.0025
        pose = np.array([state.mean[0], state.mean[1] + factor * limit * math.sqrt(spread), 0.0])
        # an angle and a position along that say nothing
        output.add_pose(state.stamp_s + 1e-9, pose, np.diag([1e6, 0.0025, 1e6]))
        assert output.newest.decision == decision
        assert output.newest.nis == pytest.approx((factor * limit) ** 2, rel=0.01)


def test_the_heading_is_wrapped_before_the_gate():
    output = OutputFilter(OutputConfig())
    output.add_pose(0.0, np.array([0.0, 0.0, math.pi - 0.01]), START)
    output.add_pose(0.05, np.array([0.0, 0.0, -math.pi + 0.01]), START)
    assert output.newest.decision == "accepted"
    assert abs(abs(output.newest.mean[2]) - math.pi) < 0.02


def test_wild_odometry_is_rejected_until_it_insists():
    config = OutputConfig()
    output = started_with_odometry(config)
    for step in range(1, REJECTIONS_MAX + 1):
        output.add_odometry(2.0 + 0.02 * step, 60.0, 0.0)
        assert output.newest.mean[3] == pytest.approx(10.0, abs=0.5)
    output.add_odometry(2.5, 60.0, 0.0)
    assert output.newest.mean[3] > 50.0
    assert output.newest.counts.odometry_rejections == REJECTIONS_MAX + 1
