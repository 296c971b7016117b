"""The matchers that are measured beside each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import StereoMatcher, make_matcher
from polemap.stereo.opencv_sgbm import OPENCV_OPTIONS, OpenCvOptions


@dataclass(frozen=True)
class Variant:
    """Settings of a matcher, and StereoSGBM's own options."""

    config: StereoConfig
    opencv: OpenCvOptions = OPENCV_OPTIONS

    def matcher(self, **changes: Any) -> StereoMatcher:
        """The matcher, with some settings changed."""
        return make_matcher(self.config.model_copy(update=changes), opencv=self.opencv)


def variants(disparities: int = 128) -> dict[str, Variant]:
    """The census matcher's main settings, and OpenCV behind every preprocessing."""
    found = {
        "census": Variant(StereoConfig(disparities=disparities)),
        "census shared": Variant(StereoConfig(disparities=disparities, right_map="shared")),
        "census 4 paths": Variant(StereoConfig(disparities=disparities, paths=4)),
    }
    base: dict[str, Any] = {"matcher": "opencv_sgbm", "disparities": disparities}
    settings: list[dict[str, Any]] = [
        {"preprocessing": "none", "block_size_px": 5, "p1": 16, "p2": 64},
        {"preprocessing": "none", "block_size_px": 3, "p1": 8, "p2": 32},
        {"preprocessing": "clahe", "block_size_px": 3, "p1": 24, "p2": 96},
        {"preprocessing": "clahe", "block_size_px": 3, "p1": 8, "p2": 32},
        {"preprocessing": "rank7x7", "block_size_px": 3, "p1": 24, "p2": 96},
        {"preprocessing": "partial_ranks", "block_size_px": 3, "p1": 24, "p2": 96},
        {"preprocessing": "census_bytes", "block_size_px": 3, "p1": 24, "p2": 96},
    ]
    for options in settings:
        name = f"opencv 3way {options['preprocessing']} {options['block_size_px']} {options['p1']}"
        found[name] = Variant(StereoConfig(**base), OpenCvOptions(**options))
    for mode in ("sgbm", "hh"):
        options = {**settings[0], "mode": mode}
        found[f"opencv {mode} none 5 16"] = Variant(StereoConfig(**base), OpenCvOptions(**options))
    return found
