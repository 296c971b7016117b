"""The disparity of a stem fitted to the images."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.refine import refine_disparity


def _pair(disparity_px: float) -> tuple[np.ndarray, np.ndarray]:
    """A smooth random texture seen twice, `disparity_px` apart."""
    rng = np.random.default_rng(1)
    waves = [(rng.uniform(0.1, 0.6), rng.uniform(0, 6), rng.uniform(0.1, 0.4)) for _ in range(12)]
    v, u = np.mgrid[0:80, 0:160].astype(float)
    left, right = (
        sum(9 * np.sin(a * (u + shift) + p + b * v) for a, p, b in waves) + 128
        for shift in (0.0, disparity_px)
    )
    return np.rint(left).astype(np.uint8), np.rint(right).astype(np.uint8)


def _fit(left: np.ndarray, right: np.ndarray, column: float, start_px: float) -> tuple:
    one = np.array([1.0])
    fit = refine_disparity(
        left, right, one * column, one * (column + 8), one * 10, one * 70, one * 0, one * start_px
    )
    return float(fit.disparity_px[0]), bool(fit.trusted[0])


def test_finds_a_fraction_of_a_pixel() -> None:
    left, right = _pair(12.3)
    disparity, trusted = _fit(left, right, 90.0, 12.8)
    assert trusted
    assert disparity == pytest.approx(12.3, abs=0.05)


@pytest.mark.parametrize("column", [0.0, 2.0])
def test_a_stem_whose_partner_is_out_of_the_picture_keeps_its_disparity(column: float) -> None:
    left, right = _pair(12.0)
    assert _fit(left, right, column, 60.0) == (60.0, False)


def test_a_blank_picture_says_nothing() -> None:
    blank = np.zeros((80, 160), dtype=np.uint8)
    assert _fit(blank, blank, 90.0, 12.0) == (12.0, False)
