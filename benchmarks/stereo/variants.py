"""The matchers that are measured beside each other."""

from __future__ import annotations

from typing import Any

from polemap.stereo.config import OpenCvConfig, StereoConfig


def variants(disparities: int = 128) -> dict[str, StereoConfig]:
    """The census matcher's main settings, and OpenCV behind every preprocessing."""
    found = {
        "census": StereoConfig(disparities=disparities),
        "census shared": StereoConfig(disparities=disparities, right_map="shared"),
        "census 4 paths": StereoConfig(disparities=disparities, paths=4),
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
        found[name] = StereoConfig(**base, opencv=OpenCvConfig(**options))
    for mode in ("sgbm", "hh"):
        options = {**settings[0], "mode": mode}
        found[f"opencv {mode} none 5 16"] = StereoConfig(**base, opencv=OpenCvConfig(**options))
    return found
