"""The filter in a town without GNSS, with wrong GNSS, and moved unknown to its odometry."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from polemap.drivelog.samples import GnssFix
from polemap.localize.config import LocalizeConfig
from polemap.localize.particle_filter.estimate import PfEstimate
from polemap.localize.particle_filter.filter import ParticleFilter
from polemap.localize.place.claims import PATTERNS_FROM, PlaceClaims, patterns_of
from polemap.map.city.city_map import CityMap
from polemap.map.pattern_index.index import PatternIndex
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import compose, relative
from tests.localize.place.town import Patterns, drive_in, index_of, town
from tests.localize.point_drives import play
from tests.pole_maps import plain_map

FEW = LocalizeConfig(particles=50)


def driven(
    pole_map: PoleMap | CityMap, seed: int, fixes: Iterable[GnssFix] = ()
) -> tuple[list[PfEstimate], ParticleFilter]:
    drive, _ = drive_in(0, seed)
    made = ParticleFilter(pole_map, FEW, 2.7, np.random.default_rng(0))
    samples = sorted([*drive.samples(), *fixes], key=lambda sample: sample.stamp_s)
    return play(made, samples), made


def off_m(estimate: PfEstimate, seed: int) -> float:
    truth = drive_in(0, seed)[1].at(estimate.stamp_s)[0]
    return float(np.hypot(*(estimate.pose[:2] - truth[:2])))


def town_map() -> PoleMap:
    return town(0).surveyed(0.05, 0)


def test_a_large_map_is_searched_by_its_patterns_where_there_is_no_gnss() -> None:
    estimates, _ = driven(town_map(), 1)
    assert estimates[0].stamp_s < 11.0
    assert off_m(estimates[0], 1) < 2.0
    assert all(off_m(estimate, 1) < 1.0 for estimate in estimates[8:])


def test_a_fix_far_away_is_overruled_by_a_claim() -> None:
    _, motion = drive_in(0, 1)
    wrong = [
        GnssFix(s, s, east + 400.0, north + 300.0, 1.0)
        for s in np.arange(0.2, 12.0)
        for east, north, _ in motion.at(s)
    ]
    estimates, _ = driven(town_map(), 1, wrong)
    assert off_m(estimates[-1], 1) < 1.0


def claims_of(index: PatternIndex | None) -> PlaceClaims:
    return PlaceClaims(Patterns(index), index_of().frame)


def claims_along(claims: PlaceClaims, seed: int, jump_s: float = np.inf) -> list[float]:
    """How far claims are off along a drive; at a moment the car is put elsewhere, unseen."""
    drive, motion = drive_in(0, seed)
    other, elsewhere = drive_in(0, seed + 1)
    errors = []
    for scan, later in zip(drive.scans, other.scans, strict=False):
        moved = scan.stamp_s >= jump_s
        shown = replace(later, stamp_s=scan.stamp_s) if moved else scan
        truth = (elsewhere if moved else motion).at(scan.stamp_s)[0]
        # odometry without errors that knows nothing of the jump
        told = relative(motion.at(0.0)[0], motion.at(scan.stamp_s)[0])
        if moved:
            before = relative(motion.at(0.0)[0], motion.at(jump_s)[0])
            step = relative(elsewhere.at(jump_s)[0], truth)
            told = compose(before, step)
        claims.add_scan(shown, told, 8.0 * scan.stamp_s)
        claim = claims.claim(told, needed=True)
        if claim is not None:
            errors.append(float(np.hypot(*(claim.pose[:2] - truth[:2]))))
    return errors


def test_claims_are_right_and_carried_by_the_odometry() -> None:
    errors = claims_along(claims_of(index_of()), 1)
    assert len(errors) > 10
    assert max(errors) < 0.7


def test_a_car_that_was_moved_is_found_again() -> None:
    errors = claims_along(claims_of(index_of()), 1, jump_s=6.0)
    assert errors[-1] < 0.7


def test_no_claim_without_an_index_and_after_forgetting() -> None:
    assert claims_along(claims_of(None), 1) == []
    claims = claims_of(index_of())
    assert claims_along(claims, 1)
    claims.forget()
    assert claims.claim(np.zeros(3), needed=True) is None
    claims.use_patterns(Patterns(None))
    assert claims.claim(np.zeros(3), needed=True) is None


def test_small_maps_keep_their_own_search() -> None:
    points = np.random.default_rng(0).uniform(0.0, 500.0, (PATTERNS_FROM, 2))
    assert patterns_of(plain_map(points[:-1]), background=False) is None
    patterns = patterns_of(plain_map(points), background=False)
    assert patterns is not None
    made = patterns.index(needed=False)
    assert made is not None
    assert len(made) == PATTERNS_FROM


def test_an_index_with_wrong_numbers_is_given_up(caplog: pytest.LogCaptureFixture) -> None:
    index = index_of()
    broken = replace(index, pole=np.full(index.triangles, len(index), dtype=np.uint32))
    assert claims_along(claims_of(broken), 1) == []
    assert caplog.text.count("names poles that are not there") == 1
