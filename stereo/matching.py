"""The door to the matchers: two rectified grey images in, two disparity maps out."""

from __future__ import annotations

from stereo.config import StereoConfig
from stereo.matching_types import DisparityPair, Image, StereoMatcher
from stereo.opencv_sgbm import OpenCvSgbm
from stereo.rig import StereoRig

__all__ = ["DisparityPair", "Image", "StereoMatcher", "make_matcher"]


def make_matcher(config: StereoConfig, rig: StereoRig | None = None) -> StereoMatcher:
    """The matcher that `config` names; with a rig it refuses images of another size."""
    return OpenCvSgbm(config, rig)
