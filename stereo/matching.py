"""The door to the matchers: two rectified grey images in, two disparity maps out."""

from __future__ import annotations

import warnings
from functools import cache

from polemap.stereo.census_sgm import KERNEL_OPTIONS, CensusSgm, KernelOptions
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching_types import DisparityPair, Image, StereoMatcher
from polemap.stereo.opencv_sgbm import OPENCV_OPTIONS, OpenCvOptions, OpenCvSgbm
from polemap.stereo.rig import StereoRig
from polemap.stereo.trust import DoubtFilter

__all__ = ["DisparityPair", "Image", "StereoMatcher", "make_matcher"]

_NO_KERNEL = (
    "the C++ extension of the census matcher is not built here: OpenCV's StereoSGBM serves "
    "instead, slower and with fewer thin poles (install a C++17 compiler and reinstall)"
)


@cache
def _warn_once() -> None:
    warnings.warn(_NO_KERNEL, RuntimeWarning, stacklevel=3)


def make_matcher(
    config: StereoConfig,
    rig: StereoRig | None = None,
    *,
    kernel: KernelOptions = KERNEL_OPTIONS,
    opencv: OpenCvOptions = OPENCV_OPTIONS,
) -> StereoMatcher:
    """The matcher that `config` names; with a rig it refuses images of another size.

    Warns once where the census matcher's extension is missing, and gives OpenCV's. `kernel` and
    `opencv` are for measurements.

    Raises:
        StereoError: the machine lacks the instruction set that `kernel` asks for.
    """
    matcher = _plain_matcher(config, rig, kernel, opencv)
    if config.outlier_chance_max >= 1.0:
        return matcher
    return DoubtFilter(matcher, config.outlier_chance_max)


def _plain_matcher(
    config: StereoConfig, rig: StereoRig | None, kernel: KernelOptions, opencv: OpenCvOptions
) -> StereoMatcher:
    if config.matcher == "opencv_sgbm":
        return OpenCvSgbm(config, rig, opencv)
    try:
        return CensusSgm(config, rig, kernel)
    except ImportError:
        _warn_once()
        return OpenCvSgbm(config, rig, opencv)
