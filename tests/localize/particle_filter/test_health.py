"""Being lost is noticed, and exploration is called for when the likelihood falls, not before."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from polemap.localize.config import KldConfig, LocalizeConfig, RecoveryConfig
from polemap.localize.particle_filter.exploration import (
    LikelihoodAverages,
    Quality,
    normalized_quality,
)
from polemap.localize.particle_filter.health import LostDetector
from polemap.localize.particle_filter.sensor_model import PoseLikelihoods


def feed(lost: LostDetector, start_s: float, seconds: float, **values: float) -> None:
    given = {
        "matched": 4,
        "seen": 5,
        "expected": 4.0,
        "geometric_sd_m": 0.1,
        "gnss_distance_sd": None,
    } | values
    for k in range(int(20 * seconds)):
        lost.add_match(start_s + 0.05 * k, **given)


def test_matching_poles_are_well() -> None:
    lost = LostDetector(RecoveryConfig())
    feed(lost, 0, 20, gnss_distance_sd=1.0)
    assert not lost.lost
    assert lost.fits
    assert lost.match_share == pytest.approx(1.0)


def test_a_wide_particle_set_is_lost_at_once() -> None:
    lost = LostDetector(RecoveryConfig())
    feed(lost, 0, 0.1, geometric_sd_m=15.1)
    assert lost.lost
    assert lost.scattered
    lost.reset()
    assert not lost.lost


def test_poles_that_do_not_fit_are_given_some_time() -> None:
    lost = LostDetector(RecoveryConfig())
    feed(lost, 0, 10)
    feed(lost, 10, 2.5, matched=0)
    assert not lost.lost
    feed(lost, 12.5, 4.0, matched=0)
    assert lost.lost
    assert not lost.scattered
    assert not lost.fits


def test_a_street_without_poles_is_not_being_lost() -> None:
    lost = LostDetector(RecoveryConfig())
    feed(lost, 0, 60, matched=0, seen=6, expected=0.0)
    feed(lost, 60, 60, matched=0, seen=0, expected=5.0)
    assert not lost.lost


def test_fixes_far_away_are_believed_when_they_persist() -> None:
    lost = LostDetector(RecoveryConfig())
    # two outliers around an outage of a minute
    lost.add_match(0.0, 4, 5, 4.0, 0.1, 40.0)
    lost.add_match(60.0, 4, 5, 4.0, 0.1, 40.0)
    assert not lost.lost
    feed(lost, 60.1, 1, gnss_distance_sd=1.0)
    feed(lost, 62, 2.8, gnss_distance_sd=8.0)
    assert not lost.lost
    feed(lost, 64.8, 0.5, gnss_distance_sd=8.0)
    assert lost.astray
    feed(lost, 66, 0.1, gnss_distance_sd=2.0)
    assert not lost.lost


def likelihoods(matched: list[int], fit: list[float], expected: list[float]) -> PoseLikelihoods:
    n = len(matched)
    return PoseLikelihoods(
        np.zeros(n),
        np.array(fit),
        np.array(expected),
        np.array(matched, dtype=np.int32),
        np.empty((0, 0), dtype=np.int32),
    )


def test_quality_is_the_kth_root_times_the_matched_share() -> None:
    weights = np.array([0.5, 0.5])
    result = likelihoods([4, 2], [-4.0, -1.0], [4.0, 4.0])
    quality = normalized_quality(result, weights, seen=6)
    assert quality.value == pytest.approx(0.5 * np.exp(-1.0) + 0.5 * 0.5 * np.exp(-0.5))
    assert quality.possible == pytest.approx(4.0)
    nothing = normalized_quality(likelihoods([0, 0], [0, 0], [0, 0]), weights, seen=3)
    assert (nothing.value, nothing.possible) == (0.0, 0.0)


def test_exploration_starts_when_the_quality_falls_and_ends_when_it_returns() -> None:
    averages = LikelihoodAverages(0.2, 0.4)
    assert averages.share == 0.0
    t = 0.0
    for _ in range(400):
        t += 0.05
        averages.add_quality(t, Quality(0.4, 4.0))
        assert averages.share == 0.0
    for _ in range(60):
        t += 0.05
        averages.add_quality(t, Quality(0.02, 4.0))
    assert averages.share > 0.05
    assert averages.share <= 0.2
    for _ in range(60):
        t += 0.05
        averages.add_quality(t, Quality(0.4, 4.0))
    assert averages.share == 0.0
    averages.reset()
    assert averages.share == 0.0


def test_scans_that_could_not_match_do_not_call_for_exploration() -> None:
    averages = LikelihoodAverages(0.2, 0.4)
    for k in range(100):
        averages.add_quality(0.05 * k, Quality(0.4, 4.0))
    for k in range(400):
        averages.add_quality(5.0 + 0.05 * k, Quality(0.0, 0.0))
    assert averages.share == 0.0


def test_settings_are_checked() -> None:
    with pytest.raises(ValidationError, match="particles_min 500 is above particles_max 100"):
        KldConfig(particles_min=500, particles_max=100)
    with pytest.raises(ValidationError, match="p_detection"):
        LocalizeConfig(p_detection=1.0)
    with pytest.raises(ValidationError, match="Extra inputs"):
        LocalizeConfig.model_validate({"particle": 10})


def test_far_fixes_do_not_carry_off_a_pose_that_poles_hold() -> None:
    lost = LostDetector(RecoveryConfig())
    feed(lost, 0, 20, gnss_distance_sd=40.0, held=True)
    assert not lost.astray
    feed(lost, 20, 4, gnss_distance_sd=40.0, held=False)
    assert lost.astray
