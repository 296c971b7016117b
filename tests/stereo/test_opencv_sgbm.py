"""The OpenCV matcher: both views, both depths, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.stereo.config import StereoConfig
from polemap.stereo.errors import StereoError
from polemap.stereo.opencv_sgbm import OpenCvSgbm
from polemap.stereo.rig import StereoRig


def shifted_pair(shift: int, dtype: type = np.uint8) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    top = 255 if dtype == np.uint8 else 4095
    wide = rng.integers(0, top, (60, 200 + shift)).astype(dtype)
    return wide[:, :200].copy(), wide[:, shift:].copy()


@pytest.mark.parametrize(
    "preprocessing", ["none", "clahe", "rank7x7", "partial_ranks", "census_bytes"]
)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_shifted_texture_has_one_disparity_in_both_views(preprocessing, dtype):
    config = StereoConfig(disparities=32, opencv_preprocessing=preprocessing)
    left, right = shifted_pair(11, dtype)
    pair = OpenCvSgbm(config).match(left, right)
    for disparity, columns in ((pair.left, slice(20, 190)), (pair.right, slice(10, 180))):
        inner = disparity[5:-5, columns]
        assert np.isfinite(inner).mean() > 0.95
        assert np.nanmedian(np.abs(inner - 11)) < 0.1


def test_what_cannot_be_matched_is_refused():
    matcher = OpenCvSgbm(StereoConfig(), StereoRig(200, 60, 100, 100, 30, 0.3))
    image = np.zeros((60, 200), np.uint8)
    with pytest.raises(StereoError, match="differ"):
        matcher.match(image, image[:, 1:])
    with pytest.raises(StereoError, match="uint8 or uint16"):
        matcher.match(image.astype(float), image.astype(float))
    with pytest.raises(StereoError, match="grey"):
        matcher.match(np.zeros((60, 200, 3), np.uint8), image)
    with pytest.raises(StereoError, match="200x60"):
        matcher.match(image[:, 1:], image[:, 1:])
    with pytest.raises(StereoError, match="min_disparity_px"):
        OpenCvSgbm(StereoConfig(min_disparity_px=300)).match(image, image)
