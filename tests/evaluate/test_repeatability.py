"""The measure returns what was put in, and nothing that must not matter changes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from polemap.evaluation.exclusions import evasive_manoeuvres, excluded_mask
from polemap.evaluation.laps import Span, find_stretches
from polemap.evaluation.repeatability import (
    Deviations,
    Repeatability,
    crossings,
    deviations,
    effective_freedom,
    guides_of,
    repeatability,
    small_sample_factor,
)
from polemap.vehicle.pose import wrap_angle
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]
Maker = Callable[..., Any]


def measured(
    track: Trajectory, guide: Trajectory | None = None, named: Sequence[Span] = ()
) -> Repeatability:
    """What the report does for one system of one recording, exclusions included."""
    guide = guide or track
    stretches = find_stretches([guide], named)
    parts: list[Deviations] = []
    for stretch in stretches:
        guides = guides_of(stretch, [guide])
        found = evasive_manoeuvres(stretch, crossings(stretch, [guide], guides))
        mask = excluded_mask(stretch, 0, found)
        parts.append(deviations(stretch, [track], guides).masked(mask))
    return repeatability(parts)


def covered(figures: list[Repeatability], sd: float) -> float:
    return float(np.mean([one.low_m <= sd <= one.high_m for one in figures]))


@pytest.mark.slow
def test_known_noise_over_200_seeds(drive_course: Maker) -> None:
    """Five to eight laps, four kinds of noise: 200 drives of known lateral sd."""
    kinds = (
        {"sd": 0.15, "correlation_m": 8.0},
        {"sd": 0.15, "correlation_m": 0.0},
        {"sd": 0.05, "correlation_m": 5.0, "lap_sd": 0.25},
        {"sd": 0.12, "correlation_m": 30.0, "swerve": (3, 140.0, 2.5)},
    )
    inside, ratios = [], []
    for seed in range(200):
        kind = kinds[seed % 4]
        driven = drive_course(seed, laps=5 + seed // 4 % 4, rate_hz=10.0, **kind)
        one = measured(driven.truth)
        true = float(np.hypot(kind["sd"], kind.get("lap_sd", 0.0)))
        inside.append(one.low_m <= true <= one.high_m)
        ratios.append((one.sd_m / true) ** 2)
    # 95 % nominal; three standard errors of a share of 200 below it.
    assert np.mean(inside) >= 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / 200)
    # The variance is unbiased: mean of 200 ratios, its spread taken from the sample itself.
    assert abs(np.mean(ratios) - 1.0) < 3.5 * np.std(ratios) / np.sqrt(200)


def test_a_drifting_reference_is_worse_than_what_it_judges(drive_course: Maker) -> None:
    figures = []
    for seed in range(8):
        driven = drive_course(seed, sd=0.1, rate_hz=10.0)
        rng = np.random.default_rng(seed)
        laps = (driven.distance_m // driven.distance_m[-1] * 6).astype(int)
        slow = np.interp(
            driven.truth.stamp_s,
            np.linspace(0, driven.truth.stamp_s[-1], 13),
            rng.normal(0, 0.8, 13),
        )
        assert laps.min() == 0
        poses = driven.truth.poses.copy()
        poses[:, 0] += -np.sin(poses[:, 2]) * slow
        poses[:, 1] += np.cos(poses[:, 2]) * slow
        drifting = measured(Trajectory(driven.truth.stamp_s, poses), driven.truth)
        figures.append((measured(driven.truth).sd_m, drifting.sd_m))
    quiet, drifting_sd = np.mean(figures, axis=0)
    assert quiet < 0.13
    assert drifting_sd > 3.0 * quiet


def test_white_jitter_is_not_averaged_away(drive_course: Maker) -> None:
    """Poses 0.8 m apart at stations 0.5 m apart: interpolation would take a third of the power."""
    driven = drive_course(3, sd=0.2, correlation_m=0.0, rate_hz=10.0)
    quiet = drive_course(3, sd=0.0, rate_hz=10.0)
    one = measured(driven.truth, quiet.truth)
    assert one.sd_m == pytest.approx(0.2, abs=4.0 * 0.2 / np.sqrt(2 * 5 * 490))


@settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    angle=st.floats(-3.1, 3.1),
    east=st.floats(-5e5, 5e5),
    north=st.floats(-6e6, 6e6),
    seed=st.integers(0, 50),
)
def test_turning_and_moving_the_plane_changes_nothing(
    drive_course: Maker, angle: float, east: float, north: float, seed: int
) -> None:
    track = drive_course(seed, laps=3, rate_hz=5.0).truth
    cos, sin = np.cos(angle), np.sin(angle)
    points = track.poses[:, :2] @ np.array([[cos, sin], [-sin, cos]]) + (east, north)
    moved = np.column_stack([points, wrap_angle(track.poses[:, 2] + angle)])
    before, after = measured(track), measured(Trajectory(track.stamp_s, moved))
    assert after.sd_m == pytest.approx(before.sd_m, rel=1e-3)
    assert after.stations == pytest.approx(before.stations, abs=2)


@settings(
    max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(seed=st.integers(0, 50))
def test_driving_the_film_backwards_changes_nothing(
    drive_course: Maker, course: Any, seed: int
) -> None:
    track = drive_course(seed, laps=4, rate_hz=5.0).truth
    end_s, lap_s = float(track.stamp_s[-1]), course.length_m / 8.0
    laps = [Span(0, k * lap_s, (k + 1) * lap_s) for k in range(4)]
    poses = track.poses[::-1].copy()
    poses[:, 2] = wrap_angle(poses[:, 2] + np.pi)
    back = Trajectory(end_s - track.stamp_s[::-1], poses)
    mirrored = [Span(0, end_s - lap.end_s, end_s - lap.start_s) for lap in reversed(laps)]
    there, again = measured(track, named=laps), measured(back, named=mirrored)
    assert again.sd_m == pytest.approx(there.sd_m, rel=0.01)


@settings(
    max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(seed=st.integers(0, 50), keep=st.integers(2, 10))
def test_the_sampling_rate_changes_little(drive_course: Maker, seed: int, keep: int) -> None:
    """50 Hz against down to 5 Hz, of deviations that the lower rate still resolves."""
    track = drive_course(seed, laps=3, rate_hz=50.0, correlation_m=10.0).truth
    thin = Trajectory(track.stamp_s[::keep], track.poses[::keep])
    assert measured(thin).sd_m == pytest.approx(measured(track).sd_m, rel=0.01)


def test_standing_still_does_not_count_double(drive_course: Maker) -> None:
    track = drive_course(2, laps=3, rate_hz=10.0).truth
    wait = 400
    stamps = np.arange(len(track) + 300) / 10.0
    poses = np.concatenate([track.poses[:wait], np.repeat(track.poses[wait : wait + 1], 300, 0),
                            track.poses[wait:]])  # fmt: skip
    assert measured(Trajectory(stamps, poses)).sd_m == pytest.approx(measured(track).sd_m, rel=1e-3)


def test_freedom_of_white_and_of_rigid_deviations() -> None:
    rng = np.random.default_rng(0)
    laps, stations = 6, 400
    white, rigid = [], []
    for _ in range(40):
        noise = rng.standard_normal((laps, stations))
        white.append(effective_freedom([noise - noise.mean(axis=0)]))
        shift = np.repeat(rng.standard_normal((laps, 1)), stations, axis=1)
        rigid.append(effective_freedom([shift - shift.mean(axis=0)]))
    assert np.median(white) == pytest.approx((laps - 1) * stations, rel=0.1)
    assert np.allclose(rigid, laps - 1)


def test_two_passes_use_the_autocorrelation() -> None:
    rng = np.random.default_rng(1)
    half = rng.standard_normal((40, 500)) / np.sqrt(2.0)
    white = [effective_freedom([np.stack([one, -one])]) for one in half]
    assert 0.6 * 500 < np.median(white) <= 500
    rigid = np.repeat([[0.3], [-0.3]], 500, axis=1)
    assert effective_freedom([rigid]) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("freedom", "factor"), [(1, 0.797885), (5, 0.951533), (10, 0.975350)])
def test_small_sample_factor(freedom: float, factor: float) -> None:
    """c4 of the statistical tables."""
    assert small_sample_factor(freedom) == pytest.approx(factor, abs=1e-6)


def test_few_laps_are_biased_as_stated(drive_course: Maker) -> None:
    """Rigid laps: the root is low by c4(L - 1); dividing by it mends the mean."""
    figures = [
        measured(drive_course(seed, laps=3, sd=0.004, lap_sd=0.3, rate_hz=5.0).truth)
        for seed in range(60)
    ]
    spread = 0.3 * np.sqrt(1.0 - small_sample_factor(2.0) ** 2)
    mean = float(np.mean([one.sd_m for one in figures]))
    mended = float(np.mean([one.unbiased_m for one in figures]))
    assert abs(mean - 0.3 * small_sample_factor(2.0)) < 3.0 * spread / np.sqrt(60)
    assert abs(mended - 0.3) < 3.0 * spread / np.sqrt(60) / small_sample_factor(2.0)
    assert all(one.population_m < one.sd_m < one.unbiased_m for one in figures)


def test_one_lap_has_no_repeatability(drive_course: Maker) -> None:
    one = measured(drive_course(0, laps=1, rate_hz=5.0).truth)
    assert np.isnan(one.sd_m)
    assert one.stations == 0


def test_poses_without_heading_are_measured_too(drive_course: Maker) -> None:
    """Some systems publish the identity as orientation."""
    track = drive_course(5, rate_hz=20.0).truth
    blind = track.poses.copy()
    blind[:, 2] = 0.0
    with_heading = measured(track)
    without = measured(Trajectory(track.stamp_s, blind), track)
    assert without.sd_m == pytest.approx(with_heading.sd_m, rel=0.02)
