"""Fusion of traversals: a covariance that holds when traversals share errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.build import merge
from polemap.build.config import MappingConfig
from polemap.build.constants import (
    DISPARITY_COMMON_SD_PX,
    DISPARITY_TRAVERSAL_SD_PX,
)
from polemap.build.merge import ReferenceError, fuse
from polemap.build.traversals import TraversalLandmarks

Floats = NDArray[np.float64]

SD_M = 0.05
CONFIG = MappingConfig(reference_yaw_sd_rad=0.0)
SYSTEMATIC_SD_M = 0.001


@pytest.fixture(autouse=True)
def small_systematic_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hardly any, so that it does not hide the errors that are tested."""
    monkeypatch.setattr(merge, "SYSTEMATIC_SD_M", SYSTEMATIC_SD_M)


ALONE = ReferenceError(traversal_sd_m=0.0, drive_sd_m=0.0, traversal_pairs=0, drive_pairs=0)


def traversals(points: Floats, gain: Floats, drives: int) -> TraversalLandmarks:
    n = len(points)
    ones = np.ones(n)
    return TraversalLandmarks(
        drive=np.array([f"d{i % drives}" for i in range(n)]),
        start_s=np.arange(n) % drives * 1.0,
        kind=np.zeros(n, dtype=np.int8),
        points_m=points,
        covariance_m2=np.tile(np.eye(2) * SD_M**2, (n, 1, 1)),
        reference_sd_m=0.0 * ones,
        gain_m_per_px=gain,
        aligned_sd_m=0.0 * ones,
        lever_m=10.0 * ones,
        direction_rad=0.0 * ones,
        width_m=ones,
        width_sd_m=ones,
        height_m=ones,
        height_sd_m=ones,
        observations=np.full(n, 20),
        first_s=0.0 * ones,
        last_s=ones,
        directions=np.ones(n, dtype=np.int64),
        range_min_m=ones,
        range_max_m=ones,
    )


def stereo(
    rng: np.random.Generator, poles: int, each: int, spread_rad: float
) -> tuple[TraversalLandmarks, NDArray[np.int64]]:
    """Traversals at poles in the origin: range error by a common bias and one of each."""
    owner = np.repeat(np.arange(poles), each)
    angle = np.repeat(rng.uniform(0, 2 * np.pi, poles), each)
    angle = angle + rng.uniform(-spread_rad, spread_rad, poles * each)
    size = rng.uniform(0.2, 1.5, poles * each)
    gain = size[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    common = np.repeat(DISPARITY_COMMON_SD_PX * rng.standard_normal(poles), each)
    own = DISPARITY_TRAVERSAL_SD_PX * rng.standard_normal(poles * each)
    noise = SD_M * rng.standard_normal((poles * each, 2))
    return traversals((common + own)[:, None] * gain + noise, gain, each), owner


def nees(points: Floats, covariance: Floats) -> float:
    """Mean squared Mahalanobis distance from the origin a degree of freedom."""
    return float(np.einsum("ni,nij,nj->n", points, np.linalg.inv(covariance), points).mean() / 2.0)


@pytest.mark.parametrize("each", [1, 2, 4])
@pytest.mark.parametrize("spread_rad", [0.1, np.pi])
def test_a_disparity_error_that_passes_share_is_owned_up_to(each: int, spread_rad: float) -> None:
    poles = 4000
    landmarks, owner = stereo(np.random.default_rng(each), poles, each, spread_rad)
    honest = nees(*fuse(landmarks, owner, CONFIG, ALONE))
    # chi-square of 2 n degrees of freedom: sd 1 / sqrt(n); traversals three by three are averaged
    # robustly, which costs a little where nothing is an outlier
    assert honest == pytest.approx(1.0, abs=5.0 / np.sqrt(poles) + (0.06 if each > 2 else 0.0))
    plain = replace(landmarks, gain_m_per_px=np.zeros_like(landmarks.gain_m_per_px))
    assert nees(*fuse(plain, owner, CONFIG, ALONE)) > 3.0


def test_passes_from_opposite_sides_cancel_what_they_share() -> None:
    gain = np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 0.0], [-1.0, 0.0]])
    owner = np.array([0, 0, 1, 1])
    landmarks = traversals(np.zeros((4, 2)), gain, 1)
    _, covariance = fuse(landmarks, owner, CONFIG, ALONE)
    mine = (SD_M**2 + DISPARITY_TRAVERSAL_SD_PX**2) / 2.0 + SYSTEMATIC_SD_M**2 * 1.5
    shared = DISPARITY_COMMON_SD_PX**2
    np.testing.assert_allclose(covariance[:, 0, 0], [mine + shared, mine], rtol=1e-9)
    np.testing.assert_allclose(
        covariance[:, 1, 1], SD_M**2 / 2.0 + SYSTEMATIC_SD_M**2 * 1.5, rtol=1e-9
    )


def test_what_levelling_leaves_does_not_average_away() -> None:
    landmarks = traversals(np.zeros((6, 2)), np.zeros((6, 2)), 2)
    owner = np.zeros(6, dtype=np.int64)
    _, plain = fuse(landmarks, owner, CONFIG, ALONE)
    aligned = replace(landmarks, aligned_sd_m=np.full(6, 0.3))
    _, covariance = fuse(aligned, owner, CONFIG, ALONE)
    np.testing.assert_allclose(covariance - plain, [0.09 * np.eye(2)], atol=1e-12)
