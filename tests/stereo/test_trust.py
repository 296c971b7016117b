"""Trust in a disparity: the two signs against plain loops, the law on recorded truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.stereo.config import StereoConfig
from polemap.stereo.errors import StereoError
from polemap.stereo.matching import DisparityPair, make_matcher
from polemap.stereo.trust import (
    AREA_PX,
    COLUMN_PX,
    LAWS,
    DoubtFilter,
    column_offset_px,
    disagreement_px,
    outlier_chance,
)


def scattered_maps(seed: int, shape: tuple[int, int] = (45, 40)) -> tuple[np.ndarray, np.ndarray]:
    """Two maps that agree in places and have holes."""
    rng = np.random.default_rng(seed)
    maps = rng.choice([4.0, 4.4, 5.0, 9.0], size=(2, *shape), p=[0.4, 0.3, 0.2, 0.1])
    maps[rng.random(maps.shape) < 0.2] = np.nan
    return maps[0].astype(np.float32), maps[1].astype(np.float32)


def street(width: int = 120, height: int = 100) -> DisparityPair:
    """A wall at 5 px and before it a pole of 3 px at 20 px, seen without error in both views."""
    left, right = (np.full((height, width), 5, np.float32) for _ in range(2))
    left[:, 60:63] = 20
    left[:, 45:60] = np.nan  # the wall that the pole hides from the right camera
    right[:, 40:43] = 20
    right[:, 43:58] = np.nan
    return DisparityPair(left, right, left, right)


def test_disagreement_is_the_mean_over_the_window_of_capped_differences():
    left, right = scattered_maps(1)
    got = disagreement_px(left, right, -1)
    wide, tall = AREA_PX[0] // 2, AREA_PX[1] // 2
    for v, u in ((22, 20), (17, 9), (25, 33)):
        costs = []
        for row in range(v - tall, v + tall + 1):
            for column in range(u - wide, u + wide + 1):
                d = left[row, column]
                partner = -1 if np.isnan(d) else column - int(np.floor(d + 0.5))
                there = right[row, partner] if partner >= 0 else np.nan
                costs.append(2.0 if np.isnan(there) else min(abs(float(there) - float(d)), 2.0))
        assert got[v, u] == pytest.approx(np.mean(costs), rel=1e-5)


def test_offset_is_from_the_known_ones_of_the_column():
    left, _ = scattered_maps(2)
    got = column_offset_px(left)
    assert (np.isnan(got) == np.isnan(left)).all()
    tall = COLUMN_PX[1] // 2
    for v, u in zip(*np.nonzero(np.isfinite(left[tall:-tall])), strict=True):
        expected = abs(left[v + tall, u] - np.nanmean(left[v : v + 2 * tall + 1, u]))
        assert got[v + tall, u] == pytest.approx(expected, abs=1e-5)


@given(st.integers(0, 1000))
def test_mirrored_pairs_have_mirrored_chances(seed):
    left, right = scattered_maps(seed)
    pair = DisparityPair(left, right, left, right)
    flipped = [np.ascontiguousarray(x[:, ::-1]) for x in (right, left)]
    one = outlier_chance(pair, "census_sgm")
    other = outlier_chance(DisparityPair(*flipped, *flipped), "census_sgm")
    np.testing.assert_allclose(one[0], other[1][:, ::-1], rtol=1e-4)
    np.testing.assert_allclose(one[1], other[0][:, ::-1], rtol=1e-4)


@pytest.mark.parametrize("matcher", LAWS)
def test_a_thin_pole_is_trusted_and_a_speck_is_not(matcher):
    pair = street()
    speck = pair.left.copy()
    speck[40:44, 90:94] = 12
    left, right = outlier_chance(replace(pair, left=speck), matcher)
    assert np.isnan(left[50, 50])
    # the band beside it, seen by one camera only, costs the pole some trust; but it is no outlier
    # of its column
    assert left[50, 20] < 0.002 < left[50, 61] < 0.02 < 0.05 < left[41, 91]
    assert right[50, 41] == left[50, 61]


class Fixed:
    """A matcher that always finds the same."""

    name = "census_sgm"

    def __init__(self, pair: DisparityPair) -> None:
        self.pair = pair

    def match(self, left: np.ndarray, right: np.ndarray) -> DisparityPair:
        return self.pair


def test_the_filter_keeps_exactly_what_the_law_trusts():
    maps = scattered_maps(3)
    pair = DisparityPair(*maps, *maps)
    image = np.zeros(maps[0].shape, np.uint8)
    chances = outlier_chance(pair, "census_sgm")
    limit = float(np.nanmedian(chances[0]))
    kept = DoubtFilter(Fixed(pair), limit).match(image, image)
    for got, chance, before in zip((kept.left, kept.right), chances, maps, strict=True):
        with np.errstate(invalid="ignore"):
            good = chance <= np.float32(limit)
        assert 0 < good.sum() < np.isfinite(before).sum()
        np.testing.assert_array_equal(got, np.where(good, before, np.float32(np.nan)))
    assert kept.left_unchecked is pair.left_unchecked


@pytest.mark.parametrize("matcher", ["census_sgm", "opencv_sgbm"])
def test_the_setting_reaches_both_matchers(matcher):
    if matcher == "census_sgm":
        pytest.importorskip("polemap.stereo.native.census_kernel")
    rng = np.random.default_rng(4)
    wide = rng.integers(0, 255, (80, 160)).astype(np.uint8)
    left, right = wide[:, :150].copy(), wide[:, 10:].copy()
    right[30:60, 40:90] = rng.integers(0, 255, (30, 50))
    base = StereoConfig(matcher=matcher, disparities=32, speckle_px=0, opencv_preprocessing="none")
    plain = make_matcher(base)
    some, few = (
        make_matcher(base.model_copy(update={"outlier_chance_max": limit}))
        for limit in (0.2, 0.005)
    )
    assert not isinstance(plain, DoubtFilter)
    assert some.name == plain.name == matcher
    counts = [np.isfinite(m.match(left, right).left).sum() for m in (plain, some, few)]
    assert counts[0] > counts[1] > counts[2] > 0


def test_what_has_no_trust_is_refused():
    maps = scattered_maps(5)
    with pytest.raises(StereoError, match="before the left-right check"):
        outlier_chance(DisparityPair(*maps), "census_sgm")
    with pytest.raises(StereoError, match="no law of trust for the matcher mine"):
        outlier_chance(DisparityPair(*maps, *maps), "mine")


def test_recorded_outliers_are_as_frequent_as_the_law_says(held_out_pairs):
    chance = np.concatenate(
        [outlier_chance(one.pair, "census_sgm")[0][one.known] for one in held_out_pairs]
    )
    wrong = np.concatenate([one.error_px > 3 for one in held_out_pairs])
    # errors within a frame hang together, so pairs count rather than pixels
    assert 0.5 < wrong.mean() / chance.mean() < 2.0
    bands = [
        wrong[(chance > a) & (chance <= b)].mean() for a, b in ((0, 0.05), (0.05, 0.2), (0.2, 1))
    ]
    assert bands[0] < 0.05 < bands[1] < 0.25 < bands[2]
