"""The kernel against the plain reference, byte for byte, and what must hold for any matcher."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tests.stereo.census_reference as reference
from polemap.stereo.census import census_pairs
from polemap.stereo.census_sgm import KernelOptions
from polemap.stereo.config import Penalties, StepPenalty, StereoConfig
from polemap.stereo.errors import StereoError
from polemap.stereo.matching import make_matcher

kernel = pytest.importorskip("polemap.stereo.native.census_kernel")

INSTRUCTION_SETS = kernel.instruction_sets()
MAPS = ("left", "right", "left_unchecked", "right_unchecked", "left_margin", "right_margin")


@st.composite
def problems(draw):
    """A small pair with every option of the kernel; flat patches make ties."""
    height = draw(st.integers(1, 12))
    width = draw(st.integers(1, 90))
    bits = draw(st.sampled_from([8, 12, 16]))
    seed = draw(st.integers(0, 2**32 - 1))
    levels = draw(st.sampled_from([1, 4, 2**bits]))
    rng = np.random.default_rng(seed)
    scene = rng.integers(0, levels, (height, width + 20)) * (2**bits // levels)
    dtype = np.uint8 if bits == 8 else np.uint16
    shift = draw(st.integers(0, 20))
    p1 = draw(st.integers(0, 40))

    def law(most):
        p2_min = draw(st.integers(p1, 60))
        p2_max = draw(st.integers(p2_min, most))
        gamma = draw(st.integers(p2_max, p2_max + 60))
        return p2_min, p2_max, gamma, draw(st.sampled_from([0, 700, 1 << 14, 1 << 17, 8 << 16]))

    across = law(75)
    options = reference.Settings(
        census=draw(st.sampled_from(["tall", "centre5x5", "symmetric7x7"])),
        bits=bits,
        smoothing=draw(st.integers(0, 2)),
        disparities=draw(st.sampled_from([1, 2, 16, 33, 64])),
        offset=draw(st.sampled_from([0, 3, 20])),
        paths=draw(st.sampled_from([4, 8])),
        own_right=draw(st.booleans()),
        p1=p1,
        across=across,
        upright=law(min(150, 255 - 2 * across[1])),
        uniqueness_percent=draw(st.sampled_from([0, 5, 30])),
        subpixel=draw(st.integers(0, 2)),
        median=draw(st.booleans()),
        tolerance=draw(st.sampled_from([-1.0, 0.0, 0.5, 1.0])),
        speckle_px=draw(st.sampled_from([0, 2, 5, 40])),
        speckle_rows=draw(st.sampled_from([1, 3, 100])),
        speckle_step_px=draw(st.sampled_from([0.0, 1.0, 2.5])),
        outside_cost=draw(st.integers(0, 24)),
        cost_weight=draw(st.sampled_from([1, 3, 8, 16])),
    )
    left = np.ascontiguousarray(scene[:, :width].astype(dtype))
    right = np.ascontiguousarray(scene[:, shift : shift + width].astype(dtype))
    return left, right, options


def make(options, threads=1, instruction_set="auto", search_strips=False):
    fields = dataclasses.asdict(options)
    return kernel.CensusMatcher(
        pairs=census_pairs(fields.pop("census")),
        **fields,
        threads=threads,
        instruction_set=instruction_set,
        search_strips=search_strips,
    )


def run(left, right, options, threads=1, instruction_set="auto", searched=()):
    return make(options, threads, instruction_set).match(left, right, list(searched))


@given(problems())
@settings(max_examples=40, deadline=None)
def test_every_build_and_thread_count_equals_the_reference(problem):
    left, right, options = problem
    expected = reference.match(left, right, options)
    for instruction_set in INSTRUCTION_SETS:
        for threads in (1, 2, 4):
            got = run(left, right, options, threads, instruction_set)
            for name, one, two in zip(MAPS, expected, got, strict=True):
                np.testing.assert_array_equal(one, two, err_msg=f"{name} {instruction_set}")


@given(
    st.integers(0, 2**32 - 1),
    st.integers(30, 80),
    st.lists(st.integers(1, 16), min_size=4, max_size=4),
    st.sampled_from([4, 8]),
    st.booleans(),
    st.sampled_from([0, 3]),
)
@settings(max_examples=8, deadline=None)
def test_strips_that_search_less_equal_the_reference(seed, height, counts, paths, own, offset):
    """A row finds nothing of what the row before did not search, and its paths pay P2 for it."""
    rng = np.random.default_rng(seed)
    scene = rng.integers(0, 256, (height, 40), dtype=np.uint8)
    left, right = scene[:, :30].copy(), scene[:, 5:35].copy()
    options = reference.Settings(disparities=16, offset=offset, paths=paths, own_right=own)
    searched = [0] * height
    for rows, count in zip(reference.strips(height), counts, strict=False):
        searched[rows] = [count] * (rows.stop - rows.start)
    expected = reference.match(left, right, options, searched)
    for instruction_set in INSTRUCTION_SETS:
        got = run(left, right, options, 2, instruction_set, searched)
        for name, one, two in zip(MAPS, expected, got, strict=True):
            np.testing.assert_array_equal(one, two, err_msg=f"{name} {instruction_set}")


def street(seed, shape=(190, 150)):
    """Background of disparity 4, and a thing of 60 in the lower half."""
    coarse = [cv2.resize(textured(seed + k, (50, 80)), (240, 190)) for k in (0, 1)]
    scene, thing = (image.astype(np.uint8) for image in coarse)
    left, right = scene[:, : shape[1]].copy(), scene[:, 4 : shape[1] + 4].copy()
    left[130:180, 90:130], right[130:180, 30:70] = thing[:50, :40], thing[:50, :40]
    return left, right


@pytest.mark.parametrize("offset", [0, 5])
def test_each_strip_searches_what_the_small_pair_shows(offset):
    left, right = street(3)
    options = reference.Settings(disparities=128, offset=offset, median=True)
    expected = reference.searched_rows(left, right, options)
    assert expected[0] == 48
    assert 68 - offset <= expected[-20] <= 80 - offset
    config = StereoConfig(disparities=128, min_disparity_px=offset, search="strips")
    for kind in INSTRUCTION_SETS:
        assert (
            make(options, instruction_set=kind, search_strips=True).searched(left, right)
            == expected
        )
    matcher = make_matcher(config)
    assert len(set(matcher.searched_rows(left, right))) > 1
    near = matcher.match(left, right).left[140:170, 100:120]
    assert np.nanmedian(np.abs(near - 60)) < 0.1
    assert np.isfinite(near).mean() > 0.9
    full = make_matcher(config.model_copy(update={"search": "full"}))
    assert full.searched_rows(left, right) == [128] * 190


@pytest.mark.parametrize("searched", [[16] * 39, [17] * 40, [0] * 40, [16] * 10 + [8] * 30])
def test_counts_that_no_strip_can_have_are_refused(searched):
    left = np.zeros((40, 30), dtype=np.uint8)
    with pytest.raises(ValueError, match="one count for each row"):
        run(left, left, reference.Settings(), searched=searched)


def textured(seed, shape, top=255):
    rng = np.random.default_rng(seed)
    return cv2.GaussianBlur(rng.uniform(0, top, shape), (3, 3), 0)


@given(
    st.integers(0, 2**31),
    st.integers(0, 40),
    st.sampled_from(["shared", "own"]),
    st.sampled_from([4, 8]),
    st.sampled_from([8, 12]),
)
@settings(max_examples=15, deadline=None)
def test_a_shifted_image_has_one_disparity_in_both_views(seed, shift, right_map, paths, bits):
    wide = textured(seed, (40, 200 + shift), 2**bits - 1).astype(
        np.uint8 if bits == 8 else np.uint16
    )
    left, right = wide[:, :200], wide[:, shift:]
    config = StereoConfig(disparities=48, right_map=right_map, paths=paths, uint16_bits=bits)
    pair = make_matcher(config).match(left, right)
    # at the edges of the image the census sees repeated pixels
    for disparity in (pair.left[4:-4, shift + 6 : -6], pair.right[4:-4, 6 : 194 - shift]):
        assert np.isfinite(disparity).mean() > 0.99
        near = np.abs(disparity - shift)[np.isfinite(disparity)] <= 0.5  # a parabola's top
        assert near.mean() > 0.998  # paths that begin at an edge can carry its error inwards
        assert abs(np.nanmedian(disparity) - shift) < 0.05


@given(st.integers(0, 2**31), st.sampled_from([4, 8]), st.booleans())
@settings(max_examples=10, deadline=None)
def test_mirrored_and_exchanged_views_give_the_mirrored_maps(seed, paths, median):
    left = textured(seed, (30, 120)).astype(np.uint8)
    right = np.roll(left, -7, axis=1)
    config = StereoConfig(disparities=32, right_map="own", paths=paths)
    matcher = make_matcher(config, kernel=KernelOptions(median=median))
    pair = matcher.match(left, right)
    mirrored = matcher.match(right[:, ::-1], left[:, ::-1])
    for one, two in (("left", "right"), ("left_unchecked", "right_unchecked")):
        np.testing.assert_array_equal(getattr(pair, two), getattr(mirrored, one)[:, ::-1])
        np.testing.assert_array_equal(getattr(pair, one), getattr(mirrored, two)[:, ::-1])


@given(st.floats(0.4, 1.5), st.floats(-20, 40), st.integers(0, 2**31))
@settings(max_examples=10, deadline=None)
def test_census_does_not_see_gain_and_offset(gain, offset, seed):
    wide = textured(seed, (40, 160), 1500)
    left, right = wide[:, :150] + 300, wide[:, 9:159] + 300
    config = StereoConfig(disparities=32, right_map="shared", uint16_bits=12)
    matcher = make_matcher(config)
    plain = matcher.match(left.astype(np.uint16), right.astype(np.uint16))
    changed = matcher.match(left.astype(np.uint16), (gain * right + offset).astype(np.uint16))
    known = np.isfinite(plain.left) & np.isfinite(changed.left)
    # rounding makes or breaks ties, no more
    assert known.mean() > 0.9
    assert np.mean(np.abs(plain.left - changed.left)[known] < 0.5) > 0.995


def test_the_search_range_is_kept_with_an_offset():
    wide = textured(1, (30, 260)).astype(np.uint8)
    left, right = wide[:, :200], wide[:, 45:245]
    pair = make_matcher(StereoConfig(min_disparity_px=40, disparities=16)).match(left, right)
    assert np.nanmax(np.abs(pair.left[4:-4, 52:-6] - 45)) <= 0.5
    assert np.isnan(pair.left[:, :40]).all()
    assert pair.left_unchecked is not None
    assert np.isnan(pair.left_unchecked[:, :40]).all()
    assert np.isfinite(pair.left_unchecked[:, 40:]).all()


def test_what_the_matcher_refuses():
    matcher = make_matcher(StereoConfig(uint16_bits=12))
    bright = np.full((20, 80), 5000, np.uint16)
    with pytest.raises(StereoError, match="uint16_bits"):
        matcher.match(bright, bright)
    with pytest.raises(StereoError, match="differ"):
        matcher.match(bright, bright[:, :-1])
    if "avx512" not in INSTRUCTION_SETS:
        with pytest.raises(StereoError, match="instruction_set"):
            make_matcher(StereoConfig(), kernel=KernelOptions(instruction_set="avx512"))
    with pytest.raises(ValueError, match="out of its range"):
        run(bright, bright, reference.Settings(upright=(20, 200, 200, 0)))
    with pytest.raises(ValueError, match="p1 <= p2_min"):
        Penalties(p1=30)
    with pytest.raises(ValueError, match="p2_min <= p2_max"):
        StepPenalty(p2_min=30, p2_max=20, gamma=40, alpha=1)
    steep = StepPenalty(p2_min=10, p2_max=100, gamma=100, alpha=1)
    with pytest.raises(ValueError, match="is 320, above 255"):
        Penalties(upright=StepPenalty(p2_min=10, p2_max=120, gamma=120, alpha=1), across=steep)


def test_one_matcher_serves_threads_and_sizes():
    """Memory is kept between calls: neither other sizes nor other threads may show in a result."""
    matcher = make_matcher(StereoConfig(disparities=32))
    pairs = []
    for seed, shape in enumerate([(40, 150), (90, 70), (17, 201), (40, 150)]):
        wide = textured(seed, shape).astype(np.uint8)
        pairs.append((wide[:, :-6], wide[:, 6:]))
    alone = [make_matcher(StereoConfig(disparities=32)).match(*pair).left for pair in pairs]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda pair: matcher.match(*pair).left, pairs * 3))
    for expected, got in zip(alone * 3, together, strict=True):
        np.testing.assert_array_equal(expected, got)


def test_maps_are_kept_while_python_holds_them():
    """Their memory is used again, but not before the last reference has gone."""
    matcher = make_matcher(StereoConfig(disparities=32))
    wide = textured(3, (60, 170)).astype(np.uint8)
    first = matcher.match(wide[:, :160], wide[:, 7:167])
    row = first.left[30]
    before = [getattr(first, name).copy() for name in MAPS]
    for shift in range(10):
        matcher.match(wide[:, :160], wide[:, shift : shift + 160])
    for name, expected in zip(MAPS, before, strict=True):
        np.testing.assert_array_equal(getattr(first, name), expected)
    del first
    other = matcher.match(wide[:, 8:168], wide[:, :160])
    del matcher
    np.testing.assert_array_equal(row, before[0][30])
    assert other.left.flags.writeable
