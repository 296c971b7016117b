"""Recorded pairs on which no table and no law was fitted, matched once for all tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import DisparityPair, make_matcher


@dataclass(frozen=True)
class Matched:
    """A pair: its left picture, what was found, and the error where truth and disparity are known.

    `known` is `(h, w)`, `error_px` `(n,)`.
    """

    pair: DisparityPair
    known: NDArray[np.bool_]
    error_px: NDArray[np.float64]


@pytest.fixture(scope="session")
def held_out_pairs(recording: Callable[[str], Path]) -> list[Matched]:
    """Every second pair of KITTI 2015 was used for calibration; these are of the others."""
    pytest.importorskip("polemap.stereo.native.census_kernel")
    folder = recording("kitti_2015") / "training"
    matcher = make_matcher(StereoConfig())
    found = []
    for number in (2, 4, 8, 10, 12):
        name = f"{number:06d}_10.png"
        left, right = (cv2.imread(str(folder / f"image_{k}" / name), 0) for k in (2, 3))
        truth = cv2.imread(str(folder / "disp_noc_0" / name), cv2.IMREAD_UNCHANGED) / 256
        pair = matcher.match(left, right)
        known = (truth > 0) & np.isfinite(pair.left)
        found.append(Matched(pair, known, np.abs(pair.left[known] - truth[known])))
    return found
