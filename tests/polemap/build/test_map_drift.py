"""A reference that drifts within a drive: traversals are levelled, poles not doubled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.build import drift
from polemap.build.assemble import assemble_map
from polemap.build.config import MappingConfig
from polemap.build.drift import KNOT_S, _prior, measure_drift
from polemap.build.drive_observations import DriveObservations
from polemap.build.registration import register
from polemap.build.traversals import TraversalLandmarks
from polemap.map.pole_map import PoleMap
from tests.polemap.build.test_map_build import BLOCKS, observed, score
from tests.polemap.town import FRAME, Town, drive_through, make_town, route

CONFIG = MappingConfig()


@pytest.fixture(scope="module")
def town() -> Town:
    return make_town(np.random.default_rng(11), BLOCKS)


@pytest.fixture(scope="module")
def days(town: Town) -> list[DriveObservations]:
    """Reference that wanders by 0.6 m an axis in two minutes, as a plain INS does."""
    rng = np.random.default_rng(12)
    drives = [
        drive_through(
            town, rng, start_s=1e5 * day, poses=route(BLOCKS), vans=4, reference_sd_m=0.6,
            reference_time_s=120.0,
        )
        for day in (1, 2)
    ]  # fmt: skip
    return [observed(drive, f"day {day}") for day, drive in enumerate(drives)]


def placed(pole_map: PoleMap, town: Town) -> PoleMap:
    """The map laid onto the truth: where the reference stood on the whole nobody can tell."""
    shift = register(pole_map.points_m, town.points_m, 3.0)
    return replace(pole_map, points_m=shift.points(pole_map.points_m), _tree=None)


def test_traversals_of_one_drive_do_not_double_poles(
    days: list[DriveObservations], town: Town, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as as_they_are:
        as_they_are.setattr(drift, "DRIFT_LEAST_M", 100.0)
        doubled = assemble_map(days[:1], CONFIG, FRAME).pole_map
    built = assemble_map(days[:1], CONFIG, FRAME)
    plain, without_drift = (score(placed(m, town), town) for m in (doubled, built.pole_map))
    assert plain.duplicates > 0.05
    assert without_drift.duplicates <= 0.01
    assert without_drift.rmse_m < plain.rmse_m
    assert without_drift.missed <= 0.05
    # one error that all poles share is one draw: three sigma of it
    assert score(built.pole_map, town).nees < 9.0 / 2.0
    assert any("its reference drifts" in report for report in built.reports)


def test_drives_that_drift_apart_are_aligned(days: list[DriveObservations], town: Town) -> None:
    pole_map = assemble_map(days, CONFIG, FRAME, align=True).pole_map
    result = score(placed(pole_map, town), town)
    assert result.duplicates <= 0.01
    assert result.false <= 0.02
    assert result.missed <= 0.05
    assert score(pole_map, town).nees < 9.0 / 2.0


def moved(part: TraversalLandmarks, by: np.ndarray) -> TraversalLandmarks:
    return replace(part, points_m=part.points_m + by)


def test_a_known_drift_is_found(town: Town) -> None:
    """Two traversals of a street by one drive, 1000 s apart, the second off by a known amount."""
    rng = np.random.default_rng(13)
    part = observed(
        drive_through(town, rng, start_s=0.0, poses=route(BLOCKS), vans=0), "day"
    ).landmarks
    assert measure_drift([part], CONFIG) is None
    again = replace(
        moved(part, np.array([0.9, -0.5])), first_s=part.first_s + 1e3, last_s=part.last_s + 1e3
    )
    both = TraversalLandmarks(
        **{
            name: np.concatenate([getattr(part, name), getattr(again, name)])
            for name in TraversalLandmarks.__dataclass_fields__
        }
    )
    drifts = measure_drift([both], CONFIG)
    assert drifts is not None
    middle = np.array([100.0, 200.0])
    difference = drifts[0].at(middle + 1e3) - drifts[0].at(middle)
    np.testing.assert_allclose(difference, [[-0.9, 0.5]] * 2, atol=0.05)
    # which of the two is right nobody knows: each gives way by half, and the sd says so
    np.testing.assert_allclose(drifts[0].at(middle), [[0.45, -0.25]] * 2, atol=0.25)
    assert 0.2 < float(np.median(drifts[0].sd_m)) <= CONFIG.drift_sd_m


def test_an_old_map_stays_where_it_is(days: list[DriveObservations]) -> None:
    part = days[0].landmarks
    old = moved(part, np.array([1.0, 0.0]))
    drifts = measure_drift([part], CONFIG, fixed=old, between=True)
    assert drifts is not None
    assert np.median(drifts[0].sd_m) < 0.1
    north = drifts[0].at(np.linspace(part.first_s.min(), part.last_s.max(), 50))
    # the drift's own sd, twice, for each axis
    np.testing.assert_allclose(np.median(north, axis=0), [1.0, 0.0], atol=0.2)


def test_without_pairs_the_sd_is_that_of_the_settings() -> None:
    knots = [1e3 + KNOT_S * np.arange(n) for n in (1, 60, 7)]
    covariance = np.linalg.inv(_prior(knots, CONFIG).toarray())
    np.testing.assert_allclose(np.sqrt(np.diagonal(covariance)), CONFIG.drift_sd_m, rtol=0.06)
    # a hundred seconds apart the correlation is 1 / e, and none between drives
    assert covariance[10, 20] / covariance[10, 10] == pytest.approx(np.exp(-1.0), rel=0.06)
    assert covariance[0, 1] == pytest.approx(0.0, abs=1e-12)
