"""Maps that hold every pole twice are told from streets with close neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.localize.particle_filter.twins import TwinPoles, twin_offset
from tests.pole_maps import plain_map


def strewn(count: int, seed: int, extent_m: float = 40.0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-extent_m, extent_m, (count, 2))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("shift_m", [(1.0, 0.0), (-0.4, 0.5), (0.0, -2.5)])
def test_two_surveys_show_their_offset(seed: int, shift_m: tuple[float, float]) -> None:
    points = strewn(30, seed)
    noise = 0.04 * np.random.default_rng(seed).standard_normal(points.shape)
    found = twin_offset(np.vstack([points, points + shift_m + noise]))
    assert min(np.hypot(*(found - shift_m)), np.hypot(*(found + shift_m))) < 0.1


@pytest.mark.parametrize("seed", range(20))
def test_poles_that_stand_as_they_stand_are_no_twins(seed: int) -> None:
    assert not twin_offset(strewn(60, seed)).any()


def test_a_row_of_bollards_is_no_second_survey() -> None:
    row = np.stack([1.5 * np.arange(30.0), np.zeros(30)], axis=1)
    assert not twin_offset(row).any()
    assert not twin_offset(np.vstack([row, row + np.array([0.0, 9.0])])).any()


def test_few_poles_and_far_surveys_say_nothing() -> None:
    assert not twin_offset(strewn(5, 0)).any()
    assert not twin_offset(np.empty((0, 2))).any()
    points = strewn(30, 1)
    assert not twin_offset(np.vstack([points, points + np.array([20.0, 0.0])])).any()


def test_only_the_area_around_counts() -> None:
    near, far = strewn(30, 2), strewn(30, 3) + np.array([500.0, 0.0])
    twins = TwinPoles(plain_map(np.vstack([near, near + np.array([1.0, 0.0]), far])))
    assert np.hypot(*twins.offset_at(np.array([0.0, 0.0]))) == pytest.approx(1.0, abs=0.05)
    assert np.hypot(*twins.offset_at(np.array([5.0, 0.0]))) == pytest.approx(1.0, abs=0.05)
    assert not twins.offset_at(np.array([500.0, 0.0])).any()
