"""The output says when it may not be trusted, learns within bounds, and starts clean."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest

from polemap.localize.config import HealthConfig, LocalizeConfig
from polemap.localize.output_filter.config import OutputConfig
from polemap.localize.output_filter.failed_gate import reset_odometry, reset_pose_by_fixes
from polemap.localize.output_filter.filter import OutputFilter
from polemap.localize.output_filter.health import distrust
from polemap.localize.output_filter.state import NEVER, FilterState, Rival
from polemap.vehicle.packed import pack, unpack

GOOD = FilterState(
    10.0,
    (0.0,) * 9,
    pack(0.01 * np.eye(9)),
    last_pose_s=10.0,
    held_s=10.0,
    odometry_s=10.0,
)
NARROW = np.diag([0.01, 0.01, 1e-4])


def test_a_filter_on_poles_is_trusted():
    assert distrust(GOOD, 10.05, NARROW, HealthConfig()) == ""


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"last_pose_s": NEVER}, "unproven"),
        ({"doubted": True}, "odometry_doubted"),
        ({"odometry_s": 9.4}, "odometry_silent"),
        ({"last_pose_s": 4.9}, "unchecked"),
        ({"rival": Rival(9.9, (9.0, 0.0, 0.0), (0.0, 0.0, 0.0), 9.7, 3)}, "poses_rejected"),
        (
            {"held_s": 8.5, "gnss_rejected": 3, "gnss_rejected_since_s": 9.0},
            "fixes_disagree",
        ),
    ],
)
def test_every_contradiction_is_named(changes, reason):
    assert distrust(GOOD._replace(**changes), 10.0, NARROW, HealthConfig()) == reason


@pytest.mark.parametrize(("first_s", "rejected"), [(9.9, 5), (9.4, 1)])
def test_one_pose_or_a_moment_that_fails_the_gate_is_no_contradiction(first_s, rejected):
    rival = Rival(first_s, (9.0, 0.0, 0.0), (0.0, 0.0, 0.0), first_s, rejected)
    assert distrust(GOOD._replace(rival=rival), 10.0, NARROW, HealthConfig()) == ""


def test_fixes_that_fail_while_poles_are_found_are_wrong_themselves():
    state = GOOD._replace(gnss_rejected=30, gnss_rejected_since_s=0.0)
    assert distrust(state, 10.0, NARROW, HealthConfig()) == ""


def test_a_spread_that_is_of_no_use_is_not_healthy():
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    wide = NARROW.copy()
    wide[:2, :2] = turn @ np.diag([1.1**2, 0.01]) @ turn.T
    assert distrust(GOOD, 10.0, wide, HealthConfig()) == "spread"
    assert distrust(GOOD, 10.0, wide, HealthConfig(sd_max_m=1.2)) == ""
    turned = np.diag([0.01, 0.01, 0.2**2])
    assert distrust(GOOD, 10.0, turned, HealthConfig()) == "spread"


def started(speed=9.0, rate=0.3, until_s=5.0):
    output = OutputFilter(OutputConfig())
    output.add_odometry(0.0, speed, rate)
    output.add_pose(0.0, np.zeros(3), np.diag([0.01, 0.01, 1e-4]))
    for k in range(1, round(until_s * 50)):
        output.add_odometry(k / 50, speed, rate)
    return output


@pytest.mark.parametrize("seconds", [0.02, 0.1, 0.4])
def test_a_wheel_that_locks_in_a_bend_teaches_no_offset(seconds):
    output = started()
    for k in range(250, 250 + round(seconds * 50)):
        output.add_odometry(k / 50, 0.0, 0.3)
    assert abs(output.newest.mean[6]) < 0.01


def test_a_standing_car_shows_its_offset():
    output = started(0.0, 0.004, 4.0)
    assert output.newest.mean[6] == pytest.approx(0.004, abs=0.001)
    assert abs(output.newest.mean[3]) < 0.01


def test_doubted_odometry_counts_for_nothing_and_the_spread_is_a_cars():
    output = started(9.0, 0.0)
    for k in range(250, 300):
        output.add_odometry(k / 50, 0.0, 0.0, doubted=True)
    state = output.newest
    assert state.doubted
    assert state.counts.odometry_doubted == 50
    assert state.mean[3] == pytest.approx(9.0, abs=0.3)
    # white acceleration of 2.25 m^2/s^3 for a second
    assert unpack(state.upper)[3, 3] == pytest.approx(2.25, rel=0.1)


def test_a_restart_forgets_what_was_learned_of_the_odometry():
    state = GOOD._replace(
        mean=(0.0, 0.0, 0.0, 9.0, 0.1, -0.4, 0.2, 1.0, 2.0), odometry_prior=(0.0009, 2.5e-5)
    )
    clean = reset_odometry(state)
    assert clean.mean == (0.0, 0.0, 0.0, 9.0, 0.1, 0.0, 0.0, 1.0, 2.0)
    covariance = unpack(clean.upper)
    assert np.allclose(np.diag(covariance)[5:7], [0.0009, 2.5e-5])
    assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_a_start_by_fixes_knows_that_the_next_fix_errs_alike():
    state = GOOD._replace(upper=pack(np.diag([1.0] * 7 + [6.25, 6.25])))
    moved = reset_pose_by_fixes(state, (3.0, 4.0, 0.1), (6.25, 0.0, 0.0, 6.25, 0.0, 0.01))
    covariance = unpack(moved.upper)
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    assert moved.last_pose_s == -inf
    # the sum of place and shared error, which is what a fix measures, is known
    seen = np.array([1.0, 0, 0, 0, 0, 0, 0, 1.0, 0])
    assert seen @ covariance @ seen == pytest.approx(0.2 * 6.25)


@pytest.mark.parametrize("route", ["circle", "straight"])
def test_an_hour_of_fixes_and_odometry_alone_stays_where_it_is(route):
    rng = np.random.default_rng(5)
    receiver = LocalizeConfig().gnss
    output = OutputFilter(OutputConfig())
    speed, rate, keep = 10.0, 0.1 if route == "circle" else 0.0, np.exp(-1.0 / 60.0)
    wander = receiver.sd_m * rng.standard_normal(2)
    pose, errors = np.array([0.0, 0.0, 0.4]), []
    for k in range(3600 * 10):
        measured = 1.01 * speed + 0.05 * rng.standard_normal()
        output.add_odometry(k / 10, measured, rate + 0.001 + 0.002 * rng.standard_normal())
        if k % 10 == 0:
            east, north = pose[:2] + wander
            output.add_gnss(k / 10, east, north, 1.0)
            wander = keep * wander
            wander += receiver.sd_m * np.sqrt(1 - keep**2) * rng.standard_normal(2)
            if output.started and k > 1200:
                errors.append(np.hypot(*(np.array(output.newest.mean[:2]) - pose[:2])))
        half = 0.05 * rate
        chord = 0.1 * speed * np.sinc(half / np.pi)
        middle = pose[2] + half
        pose = pose + np.array([chord * np.cos(middle), chord * np.sin(middle), 2 * half])
    # raw fixes: 6.1 m; an hour holds some thirty independent errors, so a quarter more may come up
    assert np.quantile(errors, 0.95) < 7.6
    assert np.median(errors) < 3.7
    assert abs(output.newest.mean[5]) < 0.09
    assert abs(output.newest.mean[6]) < 0.015
    assert output.newest.counts.gnss_restarts == 0


def held_by_poles(fixes_off_m):
    """Ten seconds of poles, then ten of fixes alone, which are off by so much."""
    output = OutputFilter(OutputConfig())
    reasons = []
    for k in range(2000):
        t = k / 100
        if k % 2 == 0:
            output.add_odometry(t, 5.0, 0.0)
        if t < 10.0 and k % 10 == 0:
            output.add_pose(t, np.array([5.0 * t, 0.0, 0.0]), np.diag([0.01, 0.01, 1e-4]))
        if k % 50 == 0:
            output.add_gnss(t, 5.0 * t + fixes_off_m(t), 0.0, 1.0)
        state = output.newest
        reasons.append(distrust(state, t, NARROW, HealthConfig()))
    return output, reasons


def test_fixes_that_failed_while_poles_held_are_no_evidence_later():
    output, reasons = held_by_poles(lambda t: 60.0)
    assert output.newest.gnss_wrong
    assert "fixes_disagree" not in reasons
    assert output.newest.counts.gnss_restarts == 0


def test_fixes_that_come_right_are_heard_again():
    output, _ = held_by_poles(lambda t: 60.0 if t < 3.0 else 0.0)
    assert not output.newest.gnss_wrong


def test_fixes_that_agreed_and_then_do_not_are_evidence_where_no_pole_is():
    _, reasons = held_by_poles(lambda t: 0.0 if t < 12.0 else 60.0)
    assert "fixes_disagree" in reasons


def test_a_turn_in_doubt_leaves_the_speed_and_is_used_where_there_are_fixes_only():
    def turning(held_s):
        output = OutputFilter(OutputConfig())
        output.add_pose(0.0, np.zeros(3), np.diag([0.01, 0.01, 1e-4]))
        for k in range(1, 1600):
            t = k / 50
            if t < held_s and k % 10 == 0:
                output.add_pose(t, np.array([5.0 * t, 0.0, 0.0]), np.diag([0.01, 0.01, 1e-4]))
            late = t > 30.0
            output.add_odometry(t, 6.0 if late else 5.0, 0.3 if late else 0.0, turn_doubted=late)
        return output.newest

    alone, held = turning(1.0), turning(30.0)
    for state in (alone, held):
        assert state.doubted
        assert state.mean[3] == pytest.approx(6.0, abs=0.1)
    assert alone.mean[4] == pytest.approx(0.3, abs=0.1)
    assert abs(held.mean[4]) < 0.05
