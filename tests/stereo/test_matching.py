"""The choice of a matcher, and what happens where the extension was not built."""

from __future__ import annotations

import sys
import warnings

import numpy as np
import pytest

from polemap.stereo import matching
from polemap.stereo.config import StereoConfig
from polemap.stereo.errors import StereoError
from polemap.stereo.matching import make_matcher
from polemap.stereo.rig import StereoRig


def test_the_configuration_names_the_matcher():
    pytest.importorskip("polemap.stereo.native.census_kernel")
    assert make_matcher(StereoConfig()).name == "census_sgm"
    assert make_matcher(StereoConfig(matcher="opencv_sgbm")).name == "opencv_sgbm"


def test_without_the_extension_opencv_serves_with_one_warning(monkeypatch):
    monkeypatch.setitem(sys.modules, "polemap.stereo.native.census_kernel", None)
    matching._warn_once.cache_clear()
    with pytest.warns(RuntimeWarning, match="not built"):
        first = make_matcher(StereoConfig(disparities=32))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        second = make_matcher(StereoConfig(disparities=32))
    assert first.name == second.name == "opencv_sgbm"
    rng = np.random.default_rng(0)
    wide = rng.integers(0, 255, (50, 160)).astype(np.uint8)
    pair = first.match(wide[:, :150], wide[:, 8:158])
    assert np.nanmedian(pair.left) == pytest.approx(8, abs=0.1)


@pytest.mark.parametrize("name", ["census_sgm", "opencv_sgbm"])
def test_a_rig_refuses_other_sizes(name):
    rig = StereoRig(100, 50, 80.0, 50.0, 25.0, 0.3)
    matcher = make_matcher(StereoConfig(matcher=name), rig)
    with pytest.raises(StereoError, match="100x50"):
        matcher.match(np.zeros((50, 90), np.uint8), np.zeros((50, 90), np.uint8))
