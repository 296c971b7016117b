"""The door to the matchers: two rectified grey images in, two disparity maps out."""

from __future__ import annotations

import warnings
from functools import cache

from polemap.plugins import MATCHERS, installed, load_plugin, short
from polemap.stereo.census_sgm import KERNEL_OPTIONS, CensusSgm, KernelOptions
from polemap.stereo.config import OWN_MATCHERS, StereoConfig
from polemap.stereo.errors import StereoError
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
        StereoError: the machine lacks the instruction set that `kernel` asks for, or a plug-in
            makes no matcher.
        PluginError: the plug-in that `config` names cannot be loaded.
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
    if config.matcher not in OWN_MATCHERS:
        return _plugin(config, rig)
    try:
        return CensusSgm(config, rig, kernel)
    except ImportError:
        _warn_once()
        return OpenCvSgbm(config, rig, opencv)


def _plugin(config: StereoConfig, rig: StereoRig | None) -> StereoMatcher:
    """The matcher of an installed package, which is called with the settings and the rig."""
    make = load_plugin(installed(MATCHERS)[config.matcher], ("__call__",))
    try:
        matcher: StereoMatcher = make(config, rig)
    except StereoError:
        raise
    except Exception as error:
        raise StereoError(f"matcher plug-in {config.matcher} fails ({short(error)})") from error
    if not callable(getattr(matcher, "match", None)) or not hasattr(matcher, "name"):
        raise StereoError(
            f"matcher plug-in {config.matcher} makes a {type(matcher).__name__}, which has no name "
            "or no match(left, right); docs/plugins.md has a template"
        )
    return matcher
