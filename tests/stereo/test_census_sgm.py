"""The kernel against the plain reference, byte for byte, and what must hold for any matcher."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tests.stereo.census_reference as reference
from stereo.census import census_pairs

kernel = pytest.importorskip("stereo.native.census_kernel")

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
    p2_min = draw(st.integers(p1, 60))
    options = reference.Settings(
        census=draw(st.sampled_from(["centre5x5", "symmetric7x7"])),
        bits=bits,
        smoothing=draw(st.integers(0, 2)),
        disparities=draw(st.sampled_from([1, 2, 16, 33, 64])),
        offset=draw(st.sampled_from([0, 3, 20])),
        paths=draw(st.sampled_from([4, 8])),
        own_right=draw(st.booleans()),
        p1=p1,
        p2_min=p2_min,
        gamma=draw(st.integers(p2_min, 85)),
        alpha_q16=draw(st.sampled_from([0, 700, 1 << 14, 1 << 17])),
        uniqueness_percent=draw(st.sampled_from([0, 5, 30])),
        subpixel=draw(st.booleans()),
        median=draw(st.booleans()),
        tolerance=draw(st.sampled_from([-1.0, 0.0, 0.5, 1.0])),
        outside_cost=draw(st.integers(0, 24)),
        cost_weight=draw(st.sampled_from([1, 3, 8, 16])),
    )
    left = np.ascontiguousarray(scene[:, :width].astype(dtype))
    right = np.ascontiguousarray(scene[:, shift : shift + width].astype(dtype))
    return left, right, options


def run(left, right, options, threads=1, instruction_set="auto"):
    fields = dataclasses.asdict(options)
    fields["pairs"] = census_pairs(fields.pop("census"))
    matcher = kernel.CensusMatcher(**fields, threads=threads, instruction_set=instruction_set)
    return matcher.match(left, right)


@given(problems())
@settings(max_examples=60, deadline=None)
def test_every_build_and_thread_count_equals_the_reference(problem):
    left, right, options = problem
    expected = reference.match(left, right, options)
    for instruction_set in INSTRUCTION_SETS:
        for threads in (1, 2, 4):
            got = run(left, right, options, threads, instruction_set)
            for name, one, two in zip(MAPS, expected, got, strict=True):
                np.testing.assert_array_equal(one, two, err_msg=f"{name} {instruction_set}")
