"""What counts against a place, why the filter starts anew, and what the settings make of both."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from polemap.drivelog.detections import pole_detections
from polemap.drivelog.samples import GnssFix
from polemap.localize.config import LocalizeConfig
from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.localize.particle_filter.exploration import Quality
from polemap.localize.particle_filter.particles import ParticleSet
from polemap.localize.particle_filter.pole_weigher import PoleWeigher
from polemap.localize.particle_filter.recovery import Recovery
from tests.localize.streets import street


def recovery(**settings: str) -> Recovery:
    config = LocalizeConfig.model_validate({"recovery": settings})
    poles = street(np.random.default_rng(1), 40)
    return Recovery(
        poles, config.recovery, GnssReceiver(config=config.gnss), PoleWeigher(poles, config),
        np.random.default_rng(0), Counter(),
    )  # fmt: skip


def see_fix(place: Recovery, stamp_s: float, distance_sd: float) -> None:
    place.lost.add_match(stamp_s, 2, 2, 2.0, 0.1, distance_sd, held=place.held(stamp_s))


def test_a_fix_far_from_a_new_place_counts_until_poles_have_held_it() -> None:
    place = recovery()
    place.proof.believe()
    see_fix(place, 0.0, 2.0)
    assert not place.far_from_fixes
    see_fix(place, 1.0, 9.0)
    assert place.far_from_fixes
    for k in range(10):
        place.add_held(1.0 + 0.1 * k, 2, 1.0, 0.1)
    assert not place.far_from_fixes


def test_a_pose_that_has_become_wide_is_held_by_no_pole() -> None:
    place = recovery()
    place.proof.believe()
    for k in range(10):
        place.add_held(0.1 * k, 2, 1.0, 0.1)
    assert place.held(1.0)
    place.add_held(4.0, 0, 1.0, 3.5)
    see_fix(place, 5.0, 9.0)
    assert place.far_from_fixes


HERE = np.array([35.0, 0.0, 0.0])
NO_POLES = pole_detections(7.1, 7.1, np.empty((0, 2)), np.empty((0, 2, 2)))


def driven_to(place: Recovery) -> ParticleSet:
    """Particles around a place to which fixes have come along a straight road."""
    for k in range(8):
        place.search.add_fix(GnssFix(k, k, 5.0 * k, 0.0, 1.0), np.array([5.0 * k, 0.0, 0.0]))
    particles = ParticleSet(LocalizeConfig(), 2.7, np.random.default_rng(2))
    particles.place_all(np.tile(HERE, (100, 1)), np.zeros(100))
    return particles


def make_lost(place: Recovery, cause: str) -> None:
    for k in range(8):
        place.lost.add_match(
            float(k), 5 if cause != "poles" else 0, 5, 5.0, 20.0 if cause == "spread" else 0.1,
            9.0 if cause == "fixes" else 1.0,
        )  # fmt: skip
    if cause == "place":
        place.proof.was_proven = place.proof.contradicted = True


def restarts(place: Recovery, cause: str) -> dict[str, int]:
    """What is counted when the filter is asked at once."""
    make_lost(place, cause)
    place.recover(driven_to(place), NO_POLES, HERE, 0.0)
    return {name: count for name, count in place.counts.items() if "reinit" in name}


@pytest.mark.parametrize("cause", ["spread", "poles", "fixes", "place"])
def test_starts_anew_are_counted_by_cause(cause) -> None:
    counted = {"reinitializations": 1, f"reinitializations_{cause}": 1}
    assert restarts(recovery(), cause) == counted


@pytest.mark.parametrize("cause", ["poles", "fixes", "place"])
def test_where_the_spread_alone_counts_nothing_else_starts_it_anew(cause) -> None:
    assert restarts(recovery(restart="spread"), cause) == {}
    assert restarts(recovery(restart="spread"), "spread")["reinitializations_spread"] == 1


def test_classic_exploration_draws_one_less_the_ratio_after_the_estimate() -> None:
    place = recovery(exploration="classic", places="gnss")
    particles = driven_to(place)
    for k in range(30):
        place.averages.add_quality(0.1 * k, Quality(1.0, 4.0))
    assert place.averages.share == pytest.approx(0.0, abs=1e-12)
    for k in range(30, 40):
        place.averages.add_quality(0.1 * k, Quality(0.0, 4.0))
    share = place.averages.share
    assert 0.3 < share < 0.7
    assert place.recover(particles, NO_POLES, HERE, 0.0) is None
    before = particles.poses.copy()
    place.inject(particles, NO_POLES, HERE)
    moved = (np.abs(particles.poses - before).max(axis=1) > 1e-9).mean()
    assert moved == pytest.approx(share, abs=0.02)
    assert np.all(particles.log_weights == 0.0)


def test_bounded_exploration_injects_nothing() -> None:
    place = recovery()
    particles = driven_to(place)
    for k in range(40):
        place.averages.add_quality(0.1 * k, Quality(1.0 if k < 30 else 0.0, 4.0))
    before = particles.poses.copy()
    place.inject(particles, NO_POLES, HERE)
    assert np.array_equal(particles.poses, before)
