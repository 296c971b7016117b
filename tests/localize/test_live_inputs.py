"""Odd samples and clocks through the live interface: counted and dropped, and it goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from polemap.drivelog.detections import Detections
from polemap.drivelog.errors import InputError
from polemap.drivelog.samples import GnssFix, OdometrySample, Sample
from polemap.localize.clocks import ComputerClock
from polemap.localize.config import LocalizeConfig
from polemap.localize.localizer import Localizer
from polemap.localize.output_filter.limiter import OutputPose
from polemap.localize.usable import usable_fix, usable_odometry, usable_poles
from polemap.simulate.points.drive import STREWN_CITY, PointDrive, simulate_points

Change = Callable[[Iterable[Sample]], Iterator[Sample]]
ODD_S = 8.0
KINDS = [OdometrySample, GnssFix, Detections]


@cache
def city() -> PointDrive:
    return simulate_points(replace(STREWN_CITY, duration_s=14.0), np.random.default_rng(4))


def live(change: Change) -> tuple[Localizer, list[OutputPose]]:
    """Every sample as it comes, and the pose asked for after each."""
    drive = city()
    localizer = Localizer(
        drive.pole_map, LocalizeConfig(particles=200), 2.7, np.random.default_rng(0)
    )
    answers = []
    for sample in change(drive.samples):
        localizer.add_sample(sample)
        answer = localizer.pose_at(sample.arrival_s)
        if answer is not None:
            assert np.isfinite(answer.pose).all()
            assert np.isfinite(answer.covariance).all()
            answers.append(answer)
    return localizer, answers


def is_right_in_the_end(answers: list[OutputPose], shift_s: float = 0.0) -> bool:
    last = answers[-1]
    truth = city().motion.at(last.stamp_s - shift_s)[0]
    return last.healthy and bool(np.hypot(*(np.array(last.pose) - truth)[:2]) < 0.5)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("with_arrival", [False, True])
def test_one_sample_an_hour_ahead_is_dropped(kind: type, with_arrival: bool) -> None:
    def ahead(samples: Iterable[Sample]) -> Iterator[Sample]:
        sent = False
        for sample in samples:
            if isinstance(sample, kind) and sample.stamp_s > ODD_S and not sent:
                sent = True
                by_s = 3600.0 * with_arrival
                yield replace(
                    sample, stamp_s=sample.stamp_s + 3600.0, arrival_s=sample.arrival_s + by_s
                )
            yield sample

    localizer, answers = live(ahead)
    assert is_right_in_the_end(answers)
    counts = localizer.summary()
    names = (
        ["clock_ahead"] if with_arrival else [f"{s}_future" for s in ("odometry", "gnss", "camera")]
    )
    assert sum(counts.get(name, 0) for name in names) == 1


@pytest.mark.parametrize("step_s", [-3600.0, -5.0, 3600.0])
def test_a_computer_clock_that_is_set_is_followed(step_s: float) -> None:
    def stepped(samples: Iterable[Sample]) -> Iterator[Sample]:
        for sample in samples:
            if sample.arrival_s > ODD_S:
                sample = replace(
                    sample, stamp_s=sample.stamp_s + step_s, arrival_s=sample.arrival_s + step_s
                )
            yield sample

    localizer, answers = live(stepped)
    assert is_right_in_the_end(answers, step_s)
    counts = localizer.summary()
    assert counts.get("computer_clock_steps", 0) == (step_s < 0.0)
    assert counts["clock_back" if step_s < 0.0 else "clock_ahead"] == 4


def test_what_no_sensor_can_mean_is_counted_and_dropped() -> None:
    def wild(samples: Iterable[Sample]) -> Iterator[Sample]:
        for number, sample in enumerate(samples):
            yield sample
            if number % 20:
                continue
            at = sample.stamp_s
            yield OdometrySample(at + 0.001, at + 0.001, 1e308, 0.0)
            yield OdometrySample(at + 0.002, at + 0.002, 5.0, np.nan)
            yield OdometrySample(np.nan, at, 5.0, 0.0)
            yield GnssFix(at + 0.001, at + 0.001, 1e308, 0.0, 1.0)
            yield GnssFix(at + 0.002, at + 0.002, 0.0, 0.0, -1.0)
            if isinstance(sample, Detections):
                for k, spoilt in enumerate(spoilt_scans(sample)):
                    yield replace(spoilt, stamp_s=at + 0.001 * (k + 1))

    localizer, answers = live(wild)
    assert is_right_in_the_end(answers)
    counts = localizer.summary()
    for name in ("odometry_not_finite", "gnss_not_finite", "poles_not_usable"):
        assert counts[name] > 10, name


def spoilt_scans(scan: Detections) -> list[Detections]:
    n = len(scan)
    asymmetric = scan.covariance_m2.copy()
    asymmetric[:, 0, 1] += 1.0
    b = 1.0 - 1e-16  # definite by its rounding alone
    with np.errstate(over="ignore"):
        return [
            scan.with_columns(points_vehicle_m=np.full((n, 2), np.nan)),
            scan.with_columns(points_vehicle_m=scan.points_vehicle_m * 1e308),
            scan.with_columns(covariance_m2=-scan.covariance_m2),
            scan.with_columns(covariance_m2=np.zeros((n, 2, 2))),
            scan.with_columns(covariance_m2=scan.covariance_m2 * np.inf),
            scan.with_columns(covariance_m2=asymmetric),
            scan.with_columns(covariance_m2=np.tile([[1.0, b], [b, 1.0]], (n, 1, 1))),
            scan.with_columns(covariance_m2=np.tile([[1e6, 0.0], [0.0, 1e-12]], (n, 1, 1))),
            scan.with_columns(width_m=np.full(n, 1e308)),
            scan.with_columns(probability=np.full(n, np.nan)),
        ]


@pytest.mark.parametrize("value", [1e308, -1e308, 1e15])
@pytest.mark.parametrize("at_first", [True, False])
def test_times_that_no_clock_reads_are_dropped(value: float, at_first: bool) -> None:
    """However many of them agree, and be they the first that is heard of a sensor."""

    def wild(samples: Iterable[Sample]) -> Iterator[Sample]:
        left = dict.fromkeys(KINDS, 4)
        for sample in samples:
            kind = type(sample)
            if left.get(kind) and (at_first or sample.stamp_s > ODD_S):
                left[kind] -= 1
                yield replace(sample, stamp_s=value, arrival_s=value)
                yield replace(sample, stamp_s=value)
            yield sample

    localizer, answers = live(wild)
    assert is_right_in_the_end(answers)
    counts = localizer.summary()
    assert [counts[f"{name}_not_finite"] for name in ("odometry", "gnss", "camera")] == [8, 8, 8]
    assert localizer.pose_at(value) is None


@pytest.mark.parametrize(
    ("stamp_s", "pose", "covariance", "problem"),
    [
        (1e308, np.zeros(3), np.eye(3), "not_finite"),
        (5.0, np.array([1e308, 0.0, 0.0]), np.eye(3), "not_finite"),
        (5.0, np.zeros(3), 1e300 * np.eye(3), "bad_covariance"),
    ],
)
def test_a_start_that_is_nowhere_is_refused(
    stamp_s: float, pose: np.ndarray, covariance: np.ndarray, problem: str
) -> None:
    localizer = Localizer(city().pole_map, LocalizeConfig(), 2.7, np.random.default_rng(0))
    with pytest.raises(InputError, match=problem):
        localizer.start_at(stamp_s, pose, covariance)


def test_of_a_scan_the_usable_poles_are_kept() -> None:
    scan = next(s for s in city().scans if len(s) >= 2)
    assert usable_poles(scan) is scan
    unknown = scan.with_columns(width_m=np.full(len(scan), np.nan))
    assert usable_poles(unknown) is unknown
    for spoilt in spoilt_scans(scan):
        assert len(usable_poles(spoilt)) == 0
    points = scan.points_vehicle_m.copy()
    points[0] = np.inf
    assert len(usable_poles(scan.with_columns(points_vehicle_m=points))) == len(scan) - 1
    assert usable_odometry(-8.0, 0.4)
    assert not usable_odometry(np.inf, 0.0)
    assert usable_fix(388_000.0, 5_800_000.0, 0.0)
    assert not usable_fix(np.nan, 0.0, 1.0)
    assert not usable_fix(0.0, 0.0, np.inf)


@pytest.mark.parametrize("asked", [np.nan, np.inf, -np.inf, 1e308, -1e308, 14.0 + 3600.0])
def test_a_moment_that_nobody_can_know_has_no_pose(asked: float) -> None:
    localizer, answers = live(iter)
    assert is_right_in_the_end(answers)
    assert localizer.pose_at(asked) is None
    again = localizer.pose_at(13.9)
    assert again is not None
    assert np.isfinite(again.pose).all()


def test_a_steady_clock_takes_queues_and_holes_as_they_are() -> None:
    clock = ComputerClock()
    assert all(clock.accept(t) for t in (0.0, 0.5, 0.1, 1.0, 50.0, 49.5))
    assert not clock.counts
    # a hole of a day: believed once five agree
    assert [clock.accept(86_400.0 + t) for t in range(6)] == [False] * 4 + [True] * 2
    assert clock.counts == {"clock_ahead": 4}
    assert clock.correction_s == 0.0
    # strays that do not agree are never believed
    assert not any(clock.accept(t) for t in (1e6, 2e6, 3e6, 4e6, 5e6, 6e6))
    assert clock.accept(86_406.0)
    assert clock.accept(np.nan)
    # set back: what comes after it goes on where time stood
    assert [clock.accept(100.0 + t) for t in range(5)] == [False] * 4 + [True]
    assert 104.0 + clock.correction_s == pytest.approx(86_410.0)
