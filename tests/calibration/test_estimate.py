"""Robust fits: what they find, and whether their deviations are those of the scatter."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.calibration.estimate import blocks_of, fit, mean, spread


def test_a_fit_finds_a_line_among_outliers() -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, 400)
    y = 2.0 + 3.0 * x + 0.1 * rng.standard_normal(400)
    y[::10] += 20.0
    found = fit(np.column_stack([np.ones(400), x]), y, np.arange(400))
    # a tenth of outliers on one side moves Huber's mean by 0.1 * 1.345 sd / 0.9
    np.testing.assert_allclose(found.values, [2.0, 3.0], atol=0.04)


def test_deviations_hold_for_errors_that_blocks_share() -> None:
    """Over 300 draws; four standard errors of a standard deviation."""
    means, stated = [], []
    block = np.repeat(np.arange(20), 10)
    for seed in range(300):
        rng = np.random.default_rng(seed)
        values = rng.standard_normal(20)[block] + 0.3 * rng.standard_normal(200)
        value, sd = mean(values, block)
        means.append(value)
        stated.append(sd)
    assert np.mean(stated) == pytest.approx(np.std(means), rel=4 / np.sqrt(600))


def test_two_blocks_tell_nothing_of_the_scatter() -> None:
    assert fit(np.ones((10, 1)), np.arange(10.0), np.repeat([0, 1], 5)).sd[0] == np.inf
    assert spread(np.empty(0)) == 0.0


def test_blocks_of_a_short_drive_are_a_tenth_of_it() -> None:
    assert len(np.unique(blocks_of(np.arange(0, 10.0, 0.1), 5.0))) == 10
    assert len(np.unique(blocks_of(np.arange(0, 100.0, 0.1), 5.0))) == 20
    assert not len(blocks_of(np.empty(0), 1.0))
