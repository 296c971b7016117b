import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polemap.evaluation.errors import nees
from polemap.localize.output_filter.config import OutputConfig
from polemap.localize.output_filter.filter import OutputFilter, usable_pose
from polemap.localize.output_filter.noise_model import NoiseModel
from polemap.localize.output_filter.state import FilterState
from polemap.simulate.points.drive import ODOMETRY
from polemap.simulate.points.motion import WhiteAccelerations
from polemap.simulate.points.pose_source import PoseSource
from polemap.vehicle.delay import Placement
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.packed import pack, unpack
from polemap.vehicle.pose import wrap_angle
from tests.localize.output_events import (
    city_drive,
    events_of,
    give,
    odometry_of,
    run,
    started_with_odometry,
)
from tests.vehicle.ctrv_arrays import ctrv_jacobian, ctrv_process_noise, ctrv_step

PLAIN = OutputConfig(gate=False, pose_errors="independent")
NO_FLOOR = NoiseModel(pose_floor_m=0.0, pose_floor_rad=0.0)
START = np.diag([0.04, 0.04, 0.01])


def same(a, b, tolerance):
    assert a.stamp_s == b.stamp_s
    assert np.allclose(a.mean, b.mean, rtol=0, atol=tolerance)
    assert np.allclose(a.upper, b.upper, rtol=0, atol=tolerance)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000), st.booleans())
def test_any_arrival_order_within_the_horizon_gives_the_in_order_result(seed, gated):
    rng = np.random.default_rng(seed)
    drive = city_drive(rng, duration_s=1.2)
    config = PLAIN.model_copy(update={"horizon_s": 10.0, "gate": gated})
    events = [(e[1], e[2]) for e in events_of(drive)]
    if gated:
        # some wild poses, so that there are decisions to agree on
        wild = rng.random(len(events)) < 0.1
        events = [
            (kind, replace(s, pose=s.pose + np.array([3.0, 0.0, 0.0])) if kind == 1 and bad else s)
            for (kind, s), bad in zip(events, wild, strict=True)
        ]
    ordered = sorted(events, key=lambda event: (event[1].stamp_s, event[0]))
    first = next(i for i, (kind, _) in enumerate(ordered) if kind == 1)
    start, rest = ordered[first], ordered[first + 1 :]
    outputs = []
    for order in (range(len(rest)), rng.permutation(len(rest))):
        output = OutputFilter(config, noise=NO_FLOOR)
        give(output, *start)
        for i in order:
            assert give(output, *rest[i]) in (Placement.APPENDED, Placement.REPLAYED)
        outputs.append(output)
    same(outputs[0].newest, outputs[1].newest, 1e-9)
    assert outputs[0].newest.counts == outputs[1].newest.counts
    for stamp in np.linspace(start[1].stamp_s, 1.2, 20):
        decisions, distances = zip(*(one.decision_at(stamp) for one in outputs), strict=True)
        assert decisions[0] == decisions[1]
        assert distances[0] == pytest.approx(distances[1], rel=1e-6, nan_ok=True)
        same(outputs[0].predicted_to(stamp), outputs[1].predicted_to(stamp), 1e-9)


def batch_oracle(states, events, config, model):
    """All states at once by weighted least squares on the filter's own linearisation.

    An independent way to the same estimate: no gain, no recursion, one sparse-shaped system.
    """
    n = len(states)
    rows, values = [], []

    def add(entries, value, covariance):
        white = np.linalg.inv(np.linalg.cholesky(covariance))
        block = np.zeros((len(value), 9 * n))
        for index, jacobian in entries:
            block[:, 9 * index : 9 * index + 9] = jacobian
        rows.append(white @ block)
        values.append(white @ value)

    add([(0, np.eye(9))], np.array(states[0].mean), unpack(states[0].upper))
    qa = 2 * model.acceleration_mps2**2 * model.acceleration_time_s
    qw = 2 * model.yaw_acceleration_radps2**2 * model.yaw_acceleration_time_s
    for k in range(1, n):
        before = np.array(states[k - 1].mean)
        dt = states[k].stamp_s - states[k - 1].stamp_s
        if dt == 0.0:
            # two events of one moment: a transition without noise, made stiff
            transition, noise, moved = np.eye(9), 1e-16 * np.eye(9), before
        else:
            transition, noise = np.eye(9), np.zeros((9, 9))
            transition[:5, :5] = ctrv_jacobian(before[:5], dt)
            slip = 2 * model.slip_rad_per_mps2**2 * model.slip_time_s
            lasting = 2 * model.odometry_error_time_s
            noise[:5, :5] = ctrv_process_noise(
                before[:5],
                dt,
                acceleration_m2ps3=qa,
                yaw_acceleration_rad2ps3=qw,
                lateral_m2ps=slip * (before[3] ** 2 * before[4]) ** 2,
                along_m2ps=lasting * (model.speed_error_share * before[3]) ** 2,
                yaw_rad2ps=lasting * model.yaw_rate_error_radps**2 * min(1.0, before[3] ** 2)
                + 2 * model.turn_error_time_s * (model.turn_error_share * before[4]) ** 2,
            )
            times = np.array([model.odometry_drift_s, model.odometry_drift_s, 60.0, 60.0])
            sds = np.array([model.speed_scale_sd, model.yaw_rate_offset_sd_radps, 2.5, 2.5])
            kept = np.exp(-dt / times)
            transition[5:, 5:] = np.diag(kept)
            noise[5:, 5:] = np.diag((1.0 - kept**2) * sds**2)
            moved = np.concatenate([ctrv_step(before[:5], dt), kept * before[5:]])
            # the filter's yaw is wrapped, the line is not
            moved[2] = before[2] + before[4] * dt
        add([(k, np.eye(9)), (k - 1, -transition)], moved - transition @ before, noise)
        kind, sample = events[k - 1]
        if kind == 1:
            add([(k, np.eye(3, 9))], sample.pose, sample.covariance)
        else:
            jacobian = np.zeros((2, 9))
            jacobian[0, 3], jacobian[0, 5] = 1.0 + moved[5], moved[3]
            jacobian[1, 4] = jacobian[1, 6] = 1.0
            predicted = np.array([moved[3] * (1 + moved[5]), moved[4] + moved[6]])
            measured = np.array([sample.speed_mps, sample.yaw_rate_radps])
            value = measured - predicted + jacobian @ moved
            variances = [config.speed_sd_mps**2, config.yaw_rate_sd_radps**2]
            add([(k, jacobian)], value, np.diag(variances))
    matrix, value = np.vstack(rows), np.concatenate(values)
    solution = np.linalg.lstsq(matrix, value, rcond=None)[0]
    information = matrix.T @ matrix
    last = np.linalg.inv(information)[-9:, -9:]
    return solution[-9:], last


@pytest.mark.parametrize("seed", range(2))
def test_the_filter_equals_batch_least_squares_on_its_linearisation(seed):
    drive = city_drive(seed, duration_s=0.7)
    events = sorted(
        [(0, o) for o in odometry_of(drive)] + [(1, p) for p in drive.poses],
        key=lambda event: (event[1].stamp_s, event[0]),
    )
    first = next(i for i, (kind, _) in enumerate(events) if kind == 1)
    output = OutputFilter(PLAIN, noise=NO_FLOOR)
    for kind, sample in events[: first + 1]:
        give(output, kind, sample)
    states = [output.newest]
    rest = events[first + 1 :]
    for kind, sample in rest:
        give(output, kind, sample)
        states.append(output.newest)
    mean, covariance = batch_oracle(states, rest, PLAIN, NO_FLOOR)
    difference = mean - np.array(output.newest.mean)
    difference[2] = wrap_angle(difference[2])
    assert np.abs(difference).max() < 1e-6
    assert np.abs(covariance - unpack(output.newest.upper)).max() < 1e-6


MATCHED = PLAIN.model_copy(update={"yaw_rate_sd_radps": 0.002})
MATCHED_NOISE = replace(
    NO_FLOOR,
    acceleration_mps2=1.0,
    yaw_acceleration_radps2=0.1,
    slip_rad_per_mps2=0.0,
    speed_error_share=0.0,
    yaw_rate_error_radps=0.0,
    speed_scale_sd=0.01,
    odometry_drift_s=1e9,
    yaw_rate_offset_sd_radps=0.001,
)
DENSITIES = (2 * 1.0**2 * 0.5, 2 * 0.1**2 * 0.3)


def test_with_matched_noise_the_filter_is_consistent():
    """NEES averages 1 per degree of freedom at 100 Hz behind poses 110 ms late.

    Errors last some 0.3 s, so 20 drives of 10 s give about 600 independent samples of 3 degrees of
    freedom; but scale and offset are one draw a drive: 20 samples of their share. The sd of the
    mean is estimated from the drives themselves.
    """
    means = []
    for seed in range(20):
        drive = city_drive(seed, duration_s=12.0, motion=WhiteAccelerations(20.0, *DENSITIES))
        stamps, states, covariances, _ = run(drive, MATCHED, noise=MATCHED_NOISE)
        late = stamps > 2.0
        true = drive.motion.at(stamps[late])
        means.append(nees(states[late, :3], true, covariances[late]).mean() / 3.0)
    assert abs(np.mean(means) - 1.0) < 4 * np.std(means, ddof=1) / math.sqrt(20)
    assert 0.8 < np.mean(means) < 1.25


def test_late_poses_cost_little_and_ignoring_their_delay_costs_much():
    config = PLAIN
    rms = {}
    for name, latency in (("late", 0.11), ("at once", 1e-6)):
        drive = city_drive(4, duration_s=20.0, pose_source=PoseSource(latency_s=latency))
        stamps, means, _, _ = run(drive, config, noise=NO_FLOOR)
        keep = stamps > 5.0
        error = means[keep, :2] - drive.motion.at(stamps[keep])[:, :2]
        rms[name] = math.sqrt((error**2).sum(axis=1).mean())
    drive = city_drive(4, duration_s=20.0)
    ignored = [
        (a, kind, replace(s, stamp_s=a) if kind == 1 else s) for a, kind, s in events_of(drive)
    ]
    stamps, means, _, _ = run(drive, config, ignored, noise=NO_FLOOR)
    keep = stamps > 5.0
    error = means[keep, :2] - drive.motion.at(stamps[keep])[:, :2]
    rms["ignored"] = math.sqrt((error**2).sum(axis=1).mean())
    assert rms["late"] < 1.15 * rms["at once"]
    assert rms["ignored"] > 5.0 * rms["late"]


def test_what_is_wrong_with_the_odometry_is_found():
    config = ODOMETRY.model_copy(update={"speed_scale_sd": 0.0, "yaw_bias_sd_radps": 0.0})
    drive = city_drive(2, duration_s=30.0, odometry=config)
    stream = drive.drive.odometry
    wrong = replace(
        stream, speed_mps=1.03 * stream.speed_mps, yaw_rate_radps=stream.yaw_rate_radps + 0.004
    )
    _, _, _, output = run(
        replace(drive, drive=replace(drive.drive, odometry=wrong)), PLAIN, noise=NO_FLOOR
    )
    state = output.newest
    covariance = unpack(state.upper)
    bias = np.mean(wrong.yaw_rate_radps) - drive.motion.states[:, 4].mean()
    assert abs(state.mean[5] - 0.03) < 4 * math.sqrt(covariance[5, 5])
    assert abs(state.mean[6] - bias) < 4 * math.sqrt(covariance[6, 6])
    assert abs(abs(bias) - 0.004) < 0.0005


def test_standing_still_learns_the_gyro_offset_and_does_not_turn():
    output = OutputFilter(OutputConfig())
    output.add_pose(0.0, np.array([1.0, 2.0, 0.5]), START)
    rng = np.random.default_rng(1)
    for step in range(1, 1500):
        output.add_odometry(step * 0.02, 0.0, 0.004 + rng.normal(0.0, 0.002))
    state = output.newest
    assert np.allclose(state.mean[:3], [1.0, 2.0, 0.5], atol=2e-3)
    assert state.mean[6] == pytest.approx(0.004, abs=4e-4)
    assert math.sqrt(unpack(state.upper)[0, 0]) < 0.25


def test_a_pose_older_than_the_horizon_is_dropped_and_changes_nothing():
    output = started_with_odometry(OutputConfig(horizon_s=0.5))
    before = output.newest
    assert output.add_pose(1.4, np.zeros(3), START) is Placement.TOO_OLD
    assert output.newest is before


def test_odometry_before_the_first_pose_is_not_lost():
    output = OutputFilter(OutputConfig())
    for step in range(50):
        output.add_odometry(step * 0.02, 10.0, 0.1)
    output.add_pose(0.9, np.zeros(3), START)
    assert output.newest.stamp_s == pytest.approx(0.98)
    assert output.newest.mean[0] == pytest.approx(0.8, abs=0.01)


@pytest.mark.parametrize("days", [1.0, 100.0, 1e4])
def test_a_gap_of_days_leaves_a_covariance_that_can_be_used(days):
    output = OutputFilter(OutputConfig())
    stamps = [0.02 * step for step in range(50)]
    output.add_pose(0.0, np.zeros(3), START)
    for stamp in stamps:
        output.add_odometry(stamp, 9.0, 0.1)
    ahead = output.predicted_to(86_400.0 * days)
    assert np.all(np.linalg.eigvalsh(unpack(ahead.upper)[:2, :2]) > 0.0)
    for stamp in stamps:
        output.add_odometry(86_400.0 * days + stamp, 9.0, 0.1)
    output.add_pose(86_400.0 * days + 1.0, np.array([50.0, 20.0, 1.0]), START)
    covariance = unpack(output.newest.upper)
    assert np.isfinite(covariance).all()
    assert np.all(np.diag(covariance) > 0.0)


def test_use_before_a_start_is_refused():
    with pytest.raises(VehicleError, match="holds no state"):
        OutputFilter(OutputConfig()).predicted_to(1.0)


@pytest.mark.parametrize(
    ("stamp", "pose", "covariance", "problem"),
    [
        (0.0, [0.0, 0.0, 0.0], np.eye(3), None),
        (math.nan, [0.0, 0.0, 0.0], np.eye(3), "not_finite"),
        (0.0, [0.0, math.inf, 0.0], np.eye(3), "not_finite"),
        (0.0, [0.0, 0.0, 0.0], np.diag([1.0, -1.0, 1.0]), "bad_covariance"),
        (0.0, [0.0, 0.0, 0.0], np.full((3, 3), np.nan), "bad_covariance"),
    ],
)
def test_poses_that_cannot_be_used_are_recognised(stamp, pose, covariance, problem):
    assert usable_pose(stamp, np.array(pose), covariance) == problem


def test_the_state_is_a_value():
    state = FilterState(0.0, (0.0,) * 7, pack(np.eye(9)))
    with pytest.raises(AttributeError):
        state.stamp_s = 1.0  # type: ignore[misc]
