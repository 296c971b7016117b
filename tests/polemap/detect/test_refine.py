"""The disparity of a pole fitted to the images."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from polemap.detect import refine
from polemap.detect.refine import refine_disparity


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


def _fit(left: np.ndarray, right: np.ndarray, column: float, start_px: float) -> tuple[float, bool]:
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
def test_a_candidate_whose_partner_is_out_of_the_picture_keeps_its_disparity(column: float) -> None:
    left, right = _pair(12.0)
    assert _fit(left, right, column, 60.0) == (60.0, False)


def test_a_blank_picture_says_nothing() -> None:
    blank = np.zeros((80, 160), dtype=np.uint8)
    assert _fit(blank, blank, 90.0, 12.0) == (12.0, False)


def _plain(
    left: np.ndarray,
    right: np.ndarray,
    flanks: tuple[float, float],
    rows: tuple[float, float],
    slope: float,
    start_px: float,
) -> tuple[float, float, bool]:
    """One candidate at a time, on images that were smoothed as a whole."""
    one, two = (cv2.GaussianBlur(image, (3, 3), 0.8).astype(float) for image in (left, right))
    height, width = left.shape
    share = (np.arange(refine._ROWS) + 0.5) / refine._ROWS
    v = np.rint(rows[0] + (rows[1] - rows[0]) * share)
    across = np.linspace(flanks[0] - refine._BESIDE_PX, flanks[1] + refine._BESIDE_PX, 11)
    u = np.rint(across + slope * (v[:, None] - 0.5 * sum(rows))).astype(int).ravel()
    v = np.repeat(np.clip(v, 0, height - 1).astype(int), refine._COLUMNS)
    inside = (u >= 0) & (u < width)
    grey = one[v, np.clip(u, 0, width - 1)]
    shift, gain, offset = start_px, 1.0, 0.0
    for _ in range(refine._SWEEPS):
        base = np.floor(u - shift).astype(int)
        part = u - shift - base
        good = inside & (base >= 1) & (base < width - 2)
        base = np.clip(base, 1, width - 3)
        before, after = two[v, base], two[v, base + 1]
        other = before + part * (after - before)
        residual = grey - gain * other - offset
        spread = 1.4826 * np.median(np.abs(residual)) + 0.3
        weight = good / (1.0 + (residual / (2.0 * spread)) ** 2)
        design = np.stack([-gain * (after - before), other, np.ones_like(other)], axis=1)
        normal = design.T @ (design * weight[:, None])
        normal += (1e-9 * np.trace(normal) + 1e-12) * np.eye(3)
        step = np.linalg.solve(normal, design.T @ (weight * residual))
        shift += float(np.clip(step[0], -refine._STEP_PX, refine._STEP_PX))
        gain, offset = gain + step[1], offset + step[2]
    total = max(weight.sum(), 1.0)
    noise = np.sqrt((weight * residual**2).sum() / total + refine._QUANTISATION_GREY**2)
    variance = (weight * (grey - (weight * grey).sum() / total) ** 2).sum() / total
    sd = float(np.sqrt(refine._NEIGHBOURS * np.linalg.inv(normal)[0, 0]) * noise)
    trusted = 1.0 - noise**2 / max(variance, 1e-9) >= refine._CORRELATION_MIN**2
    trusted &= abs(shift - start_px) <= refine._REACH_PX and 0.4 < gain < 2.5
    return shift, sd, bool(trusted and sd < 0.5 and shift > 0.5)


def test_all_candidates_at_once_are_fitted_as_one_after_the_other() -> None:
    left, right = _pair(12.3)
    rng = np.random.default_rng(4)
    noise = rng.integers(0, 9, (2, *left.shape)).astype(np.uint8)
    left, right = left + noise[0], right + noise[1]
    n = 60
    first = rng.uniform(-3.0, 158.0, n)  # some lie on the border, or their partners beyond it
    top = rng.uniform(-4.0, 40.0, n)
    hypotheses = (first, first + rng.uniform(2, 20, n), top, top + rng.uniform(10, 45, n))
    slope, start = rng.uniform(-0.1, 0.1, n), 12.3 + rng.uniform(-1.5, 1.5, n)
    for count in (n, 3, 1):  # of few hypotheses, less of the image is looked at
        fit = refine_disparity(left, right, *(v[:count] for v in (*hypotheses, slope, start)))
        for row in range(count):
            a, b, c, d = (float(values[row]) for values in hypotheses)
            one = _plain(left, right, (a, b), (c, d), float(slope[row]), float(start[row]))
            assert fit.trusted[row] == one[2]
            expected = one[:2] if one[2] else (start[row], np.nan)
            got = (fit.disparity_px[row], fit.sd_px[row])
            assert got == pytest.approx(expected, rel=1e-9, nan_ok=True)
    assert (
        20 < np.count_nonzero(refine_disparity(left, right, *hypotheses, slope, start).trusted) < n
    )
