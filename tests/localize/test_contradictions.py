"""Odometry, poles and limits that contradict each other are noticed, and sound ones are not."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.localize.contradictions import (
    OdometryAgreement,
    PoleInnovations,
    StrangePoles,
    UnmatchedPoles,
)
from polemap.localize.odometry_watch import Held, OdometryWatch, StuckSignal

STEP_S = 0.02


def drive(speed, rate=0.1, seconds=20.0, seed=0):
    """Stamps, speeds and yaw rates with a sensor's noise; `speed` and `rate` may be functions."""
    rng = np.random.default_rng(seed)
    stamps = np.arange(0.0, seconds, STEP_S)
    v = np.array([speed(t) if callable(speed) else speed for t in stamps])
    w = np.array([rate(t) if callable(rate) else rate for t in stamps])
    noise = rng.standard_normal((2, len(stamps)))
    return stamps, v + 0.05 * noise[0], w + 0.003 * noise[1]


def doubts(watch, stamps, speeds, rates):
    return np.array(
        [watch.check(*row) is not None for row in zip(stamps, speeds, rates, strict=True)]
    )


def manoeuvres(t):
    """Full braking at 9 m/s^2 from 20 m/s, standing, and away with 4 m/s^2."""
    if t < 5.0:
        return 20.0
    if t < 9.0:
        return max(0.0, 20.0 - 9.0 * (t - 5.0))
    return min(15.0, 4.0 * (t - 9.0))


@pytest.mark.parametrize("seed", range(5))
def test_hard_driving_is_no_contradiction(seed):
    watch = OdometryWatch()
    turning = lambda t: 0.4 * np.sin(1.5 * t)  # noqa: E731
    stamps, speeds, rates = drive(manoeuvres, turning, seed=seed)
    speeds = np.where(np.abs(speeds) < 0.7, 0.0, speeds)  # wheel sensors show nothing below
    assert not doubts(watch, stamps, speeds, np.minimum(rates, 11.0 / np.maximum(speeds, 1))).any()
    assert watch.contradictions == 0


@pytest.mark.parametrize("factor", [0.0, 0.5, 1.3, 1.8])
@pytest.mark.parametrize("lasts_s", [0.1, 1.0, 5.0])
def test_a_step_of_the_speed_is_in_doubt_until_it_is_taken_back(factor, lasts_s):
    watch = OdometryWatch()
    stamps, speeds, rates = drive(9.0)
    wrong = (stamps >= 5.0) & (stamps < 5.0 + lasts_s)
    doubted = doubts(watch, stamps, np.where(wrong, factor * speeds, speeds), rates)
    assert np.array_equal(doubted, wrong)
    assert watch.contradictions == 1


def test_what_was_believed_last_is_held():
    watch = OdometryWatch()
    watch.check(0.0, 9.0, 0.2)
    held = watch.check(0.02, 0.0, 0.2)
    assert held == Held(0.0, 9.0, 0.2, -9.0, turn_doubted=False)
    assert watch.check(0.04, 0.0, 0.2) == held == watch.held
    # late samples change nothing
    assert watch.check(0.03, 9.0, 0.2) == held


def test_another_step_that_is_no_way_back_does_not_settle_it():
    watch = OdometryWatch()
    stamps, speeds, rates = drive(9.0, seconds=4.0)
    speeds = np.where(stamps >= 1.0, 2.0, speeds)
    speeds = np.where(stamps >= 2.0, 16.0, speeds)
    assert doubts(watch, stamps, speeds, rates)[stamps >= 1.0].all()


@pytest.mark.parametrize(
    "rates_of",
    [
        lambda w: -w,
        lambda w: 0.0 * w,
        np.degrees,
        lambda w: np.full_like(w, np.inf),
        lambda w: w * np.nan,
    ],
    ids=["sign", "zero", "degrees", "infinite", "nan"],
)
def test_a_turn_that_no_car_takes_is_in_doubt(rates_of):
    watch = OdometryWatch()
    stamps, speeds, rates = drive(9.0, 0.35, seconds=4.0)
    doubted = doubts(watch, stamps, speeds, np.where(stamps >= 2.0, rates_of(rates), rates))
    assert not doubted[stamps < 2.0].any()
    assert doubted[stamps >= 2.0].all()
    assert watch.held is not None
    assert watch.held.turn_doubted


def test_poles_may_contradict_and_confirm():
    watch = OdometryWatch()
    stamps, speeds, rates = drive(9.0, seconds=2.0)
    assert not doubts(watch, stamps, speeds, rates).any()
    watch.contradict(2.0)
    assert watch.check(2.02, 9.0, 0.1) is not None
    watch.confirm()
    assert watch.check(2.04, 9.0, 0.1) is None


def test_what_is_refuted_again_must_be_right_for_longer():
    watch = OdometryWatch()
    stamps, speeds, rates = drive(9.0, seconds=60.0)
    rows = list(zip(stamps, speeds, rates, strict=True))
    doubts(watch, *np.transpose(rows[:100]))
    watch.contradict(2.0)
    watch.confirm()
    assert watch.held is None
    watch.contradict(2.0)
    watch.confirm()
    assert watch.held is not None  # right on a straight is not enough a second time
    doubted = doubts(watch, *np.transpose(rows[100:]))
    assert doubted[stamps[100:] < 22.0].all()
    assert not doubted[stamps[100:] > 22.1].any()


def test_a_doubt_that_nothing_feeds_is_settled():
    watch = OdometryWatch()
    stamps, speeds, rates = drive(9.0, seconds=14.0)
    doubted = doubts(watch, stamps, np.where(stamps >= 2.0, speeds + 5.0, speeds), rates)
    assert doubted[(stamps >= 2.0) & (stamps < 12.0)].all()
    assert not doubted[stamps > 12.1].any()


def corrections(watch, drift, seed, seconds=60.0, hz=22.0):
    """Scans that correct what a Kalman filter would have to, its motion off by `drift` (3,) a s."""
    rng = np.random.default_rng(seed)
    q, r = np.array([0.09, 0.04, 0.01]) ** 2 / hz, np.array([0.2, 0.1, 0.01]) ** 2
    p, error, alarms = q.copy(), np.zeros(3), []
    for k in range(int(seconds * hz)):
        p, error = p + q, error + np.sqrt(q) * rng.standard_normal(3) - np.asarray(drift) / hz
        gain = p / (p + r)
        moved = gain * (error + np.sqrt(r) * rng.standard_normal(3))
        before = (np.zeros(3), np.diag(p))
        p, error = (1 - gain) * p, error - moved
        alarms.append(watch.contradict(k / hz, before, (moved, np.diag(p)), steady=True))
    return np.array(alarms)


def test_corrections_as_large_as_expected_are_no_contradiction():
    # 20 minutes of a consistent filter: the windows' false alarm is 6e-7 for each of the three
    assert not any(corrections(PoleInnovations(), np.zeros(3), seed).any() for seed in range(20))


@pytest.mark.parametrize("drift", [(2.7, 0, 0), (0, 1.0, 0), (0, 0, 0.2), (0, 0, -0.2)])
def test_a_motion_that_is_off_is_contradicted_within_two_seconds(drift):
    for seed in range(5):
        alarms = corrections(PoleInnovations(), np.array(drift), seed, seconds=2.0)
        assert alarms.any()


def test_a_window_starts_anew_where_the_pose_is_not_held():
    watch = PoleInnovations()
    moved = np.array([0.5, 0.0, 0.0])
    narrow, wide = np.diag([1e-4] * 3), np.diag([2e-4] * 3)
    for k in range(10):
        assert not watch.contradict(0.1 * k, (np.zeros(3), wide), (moved, narrow), steady=False)
    assert watch.contradict(1.0, (np.zeros(3), wide), (moved, narrow), steady=True)


def test_a_second_without_a_match_where_there_should_be_is_evidence():
    watch = UnmatchedPoles()
    said = [watch.contradict(0.1 * k, 0, 1.5) for k in range(12)]
    assert said == [False] * 8 + [True] * 4
    # where the map has nothing, nothing can match
    empty = UnmatchedPoles()
    assert not any(empty.contradict(0.1 * k, 0, 0.2) for k in range(30))
    # a map of which a good part is gone still finds some
    aged = UnmatchedPoles()
    assert not any(aged.contradict(0.1 * k, int(k % 3 == 0), 2.0) for k in range(30))
    watch.forget()
    assert not watch.contradict(2.0, 0, 1.5)


def test_right_poles_contradict_less_than_once_in_a_million_seconds():
    # detections of 0.6 each, 1.5 hoped for a scan, 11 a second: P(no match) = 0.4 ** 16
    rng = np.random.default_rng(3)
    watch = UnmatchedPoles()
    found = rng.binomial(2, 0.6, size=20_000)
    assert not any(watch.contradict(k / 11.0, n, 1.5) for k, n in enumerate(found))


def test_odometry_is_confirmed_by_those_that_follow_it_where_poles_are_seen():
    agreement = OdometryAgreement()
    said = [agreement.confirm(0.9, 2, 0.1) for _ in range(25)]
    assert said[-1]
    assert not any(said[:10])
    agreement.forget()
    assert not any(agreement.confirm(0.9, 0, 0.1) for _ in range(50))  # no pole, no word
    assert not any(agreement.confirm(0.3, 3, 0.1) for _ in range(50))  # poles refute it


@pytest.mark.parametrize("signal", ["speed", "turn"])
def test_a_signal_that_never_repeated_itself_and_now_does_is_stuck(signal):
    watch = OdometryWatch()
    # the steps from and to the stuck values are no larger than a car's
    stamps, speeds, rates = drive(9.0, 0.05)
    wrong = (stamps >= 5.0) & (stamps < 7.0)
    stuck = (np.where(wrong, 9.0, speeds), rates) if signal == "speed" else (
        speeds, np.where(wrong, 0.05, rates)
    )  # fmt: skip
    doubted = doubts(watch, stamps, *stuck)
    assert not doubted[stamps < 5.1].any()
    assert doubted[(stamps > 5.2) & (stamps < 7.0)].all()
    assert watch.held is None or watch.held.speed_doubted == (signal == "speed")


def test_coarse_signals_and_standing_cars_are_not_stuck():
    rng = np.random.default_rng(1)
    coarse = StuckSignal()
    values = np.round(9.0 + 0.05 * rng.standard_normal(5000), 1)
    assert not any(coarse.stuck(value) for value in values)
    assert not any(coarse.stuck(9.0) for _ in range(50))
    watch = OdometryWatch()
    stamps, speeds, rates = drive(9.0)
    still = stamps >= 10.0
    speeds = np.where(still, np.maximum(0.0, 9.0 - 6.0 * (stamps - 10.0)), speeds)
    assert not doubts(watch, stamps, speeds, np.where(speeds > 0.0, rates, 0.0)).any()


def test_a_turn_that_no_car_takes_leaves_the_speed_believed():
    watch = OdometryWatch()
    watch.check(0.0, 9.0, 0.2)
    held = watch.check(0.02, 9.0, -0.2)
    assert held == Held(0.0, 9.0, 0.2, 0.0, turn_doubted=True, speed_doubted=False)
    watch.contradict(0.03)  # what poles say is of both
    assert watch.held is not None
    assert watch.held.speed_doubted


def scans(strange, seconds, share_matched, misfit, seed=0, seen=2, mapped=True):
    """Eleven scans a second of `seen` poles, a third of them independent; when it contradicts."""
    rng = np.random.default_rng(seed)
    said = []
    for _ in range(int(11 * seconds)):
        matched = int(rng.binomial(seen, share_matched))
        distance = misfit / 2.0 * float(rng.chisquare(2, matched).sum())
        strange.add_scan(matched, seen, distance, 0.3, mapped=mapped)
        said.append(strange.contradict)
    return np.array(said)


@pytest.mark.parametrize(
    ("share", "misfit"), [(0.9, 1.5), (0.95, 1.2), (0.8, 2.3), (0.7, 1.8)],
    ids=["points", "Victoria Park", "KITTI 03", "aged map"],
)  # fmt: skip
def test_poles_that_fit_as_ever_are_not_strange(share, misfit):
    for seed in range(10):
        assert not scans(StrangePoles(), 120.0, share, misfit, seed).any()


@pytest.mark.parametrize(
    ("share", "misfit", "within_s"), [(0.0, 0.0, 1.5), (0.55, 5.5, 5.0)],
    ids=["a wrong pose", "ranges a tenth wrong"],
)  # fmt: skip
def test_poles_that_do_not_fit_are_strange(share, misfit, within_s):
    for seed in range(10):
        strange = StrangePoles()
        scans(strange, 30.0, 0.9, 1.5, seed)
        said = scans(strange, 20.0, share, misfit, seed)
        assert said[: int(11 * within_s)].any()
        # and are no longer once they fit again
        assert not scans(strange, 10.0, 0.95, 1.5, seed)[-1]


def test_where_the_map_has_no_poles_none_is_strange():
    assert not scans(StrangePoles(), 30.0, 0.0, 0.0, mapped=False).any()


def test_a_restart_gives_half_the_benefit_of_the_doubt():
    strange = StrangePoles()
    scans(strange, 10.0, 0.0, 0.0)
    assert strange.contradict
    strange.forget()
    assert not strange.contradict
    assert scans(strange, 1.0, 0.0, 0.0).any()


def test_a_map_that_is_out_of_date_makes_the_pose_less_sure():
    fresh, aged = StrangePoles(), StrangePoles()
    scans(fresh, 120.0, 0.97, 1.5)
    scans(aged, 120.0, 0.6, 1.5)
    assert fresh.map_sd_m == pytest.approx(0.0, abs=0.01)
    assert aged.map_sd_m == pytest.approx(0.4 * (0.93 - 0.6), abs=0.04)
