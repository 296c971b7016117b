"""The errors of fixes, measured: what a map is off by is what they say it is."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.build.slam.config import SlamConfig
from polemap.build.slam.fix_noise import FixNoise, measure_fixes, stated_fixes

Floats = NDArray[np.float64]
STEP_S, WHITE_M = 2.0, 0.4


def wandering(n: int, sd_m: float, lasts_s: float, rng: np.random.Generator) -> Floats:
    share = np.exp(-STEP_S / lasts_s)
    kick = sd_m * np.sqrt(1.0 - share**2) * rng.standard_normal((n, 2))
    kick[0] = sd_m * rng.standard_normal(2)
    for row in range(1, n):
        kick[row] += share * kick[row - 1]
    return kick


def measured(drives: list[Floats], rng: np.random.Generator, outliers: int = 0) -> FixNoise:
    """Of drives whose fixes have these errors, against a map that stands on their mean."""
    n = [len(one) for one in drives]
    off = np.concatenate(drives) + WHITE_M * rng.standard_normal((sum(n), 2))
    off -= off.mean(axis=0)
    weight = np.ones(len(off))
    wrong = rng.choice(len(off), outliers, replace=False)
    off[wrong] += 60.0
    weight[wrong] = 1e-4
    place = np.concatenate([np.cumsum(12.0 * rng.standard_normal((k, 2)), axis=0) for k in n])
    rows = np.arange(len(off))
    problem: Any = SimpleNamespace(
        bias_share=np.concatenate([[0.0, *[0.9] * (k - 1)] for k in n]),
        fix_m=place + off, fix_antenna_m=np.zeros_like(place), fix_from=rows,
        points_m=np.zeros((1, 2)), link=np.zeros((1, 2), dtype=np.int64), seen_from=rows,
        seen=np.zeros(len(rows), dtype=np.int64), poses=np.zeros((len(rows), 3)),
        motion_from=rows[:-1], beside=0,
    )  # fmt: skip
    poses = np.column_stack([place, np.zeros(len(place))])
    solution: Any = SimpleNamespace(poses=poses, fix_weight=weight)
    stamps = np.concatenate([STEP_S * np.arange(k) for k in n])
    return measure_fixes(problem, solution, stamps, np.ones(len(off)), SlamConfig())


@pytest.mark.parametrize(("sd_m", "lasts_s"), [(2.5, 60.0), (1.0, 20.0), (4.0, 120.0)])
def test_the_mean_of_fixes_is_as_far_off_as_stated(sd_m: float, lasts_s: float) -> None:
    """NEES of the mean of two drives of eight minutes; 30 pairs have a deviation of 0.18."""
    rng = np.random.default_rng(411)
    nees = []
    for _ in range(30):
        drives = [wandering(240, sd_m, lasts_s, rng) for _ in range(2)]
        noise = measured(drives, rng)
        rho = np.exp(-STEP_S / noise.correlation_s) ** np.abs(np.subtract.outer(*2 * [range(240)]))
        variance = 0.5 * (noise.lasting_m**2 * rho.mean() + noise.white_m**2 / 240)
        nees.append(np.sum(np.concatenate(drives).mean(axis=0) ** 2) / variance / 2.0)
    assert 0.4 < np.mean(nees) < 1.7


def test_much_data_overrules_the_settings_and_outliers_do_not_count() -> None:
    rng = np.random.default_rng(412)
    noise = measured([wandering(1500, 1.2, 20.0, rng)], rng, outliers=30)
    assert 0.9 < noise.sd_m < 1.7
    assert 10.0 < noise.correlation_s < 45.0
    assert 0.2 < noise.white_m < 0.7


def test_few_fixes_say_nothing_against_the_settings() -> None:
    rng = np.random.default_rng(413)
    assert measured([wandering(2, 9.0, 5.0, rng)], rng) == stated_fixes(SlamConfig())
    short = measured([wandering(6, 0.5, 60.0, rng)], rng)
    assert short.sd_m > 1.0
    small = stated_fixes(SlamConfig(gnss_sd_m=0.1))
    assert 0.0 < small.white_m < small.sd_m
