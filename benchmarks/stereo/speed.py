"""How long a pair takes: `python -m benchmarks.stereo.speed [LEFT RIGHT] [--runs N]`.

Both disparity maps with all checks at 768x480, two threads, every instruction set of this machine
beside OpenCV's StereoSGBM (both views in two threads), interleaved in one run. Without images a
rendered pair is matched; the time hardly depends on the content.
"""

from __future__ import annotations

from functools import partial
from importlib import import_module
from pathlib import Path

import cv2
import numpy as np

from benchmarks.harness import command_line, interleaved, summary
from benchmarks.stereo.pairs import read_grey
from benchmarks.stereo.scenes import rendered_scene
from polemap.stereo.census_sgm import KernelOptions
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import Image, StereoMatcher, make_matcher
from polemap.stereo.opencv_sgbm import OpenCvOptions

SIZE_PX = (768, 480)


def matchers() -> dict[str, tuple[StereoMatcher, int]]:
    """Every variant that is measured, and its number of disparities."""
    found: dict[str, tuple[StereoMatcher, int]] = {}
    for disparities in (64, 128):
        for kind in import_module("polemap.stereo.native.census_kernel").instruction_sets():
            for paths, right in ((8, "shared"), (4, "own"), (8, "own")):
                config = StereoConfig(disparities=disparities, paths=paths, right_map=right)
                kernel = KernelOptions(instruction_set=kind)
                name = f"census_{kind}_{paths}paths_{right}_{disparities}"
                found[name] = make_matcher(config, kernel=kernel), disparities
        for mode in ("sgbm", "3way"):
            config = StereoConfig(
                matcher="opencv_sgbm", disparities=disparities, opencv_preprocessing="none"
            )
            opencv = OpenCvOptions(mode=mode)
            found[f"opencv_{mode}_{disparities}"] = (
                make_matcher(config, opencv=opencv),
                disparities,
            )
    return found


def measure(left: Image, right: Image, runs: int) -> dict[str, dict[str, float]]:
    """Medians over interleaved runs, and the ratio of OpenCV's StereoSGBM to each."""
    cv2.setNumThreads(1)  # one thread for each view, as the matcher starts them
    variants = matchers()
    work = {name: partial(matcher.match, left, right) for name, (matcher, _) in variants.items()}
    times = interleaved(work, runs, warm_up=1)  # the first run allocates
    medians = {name: float(np.median(values)) for name, values in times.items()}
    return {
        f"stereo_{name}": {
            **summary(values),
            "min_ms": 1e3 * min(values),
            "opencv_sgbm_over_this": medians[f"opencv_sgbm_{variants[name][1]}"] / medians[name],
        }
        for name, values in times.items()
    }


def run() -> dict[str, dict[str, float]]:
    """For `python -m benchmarks`."""
    scene = rendered_scene(1)
    return measure(scene.left, scene.right, 9)


def _resized(path: Path) -> Image:
    return np.asarray(cv2.resize(read_grey(path), SIZE_PX), dtype=np.uint8)


def main() -> None:
    """The command line."""
    # two images LEFT RIGHT are resized to 768x480
    options = command_line(__doc__, paths="images", runs=9)
    if options.images:
        left, right = (_resized(path) for path in options.images)
    else:
        scene = rendered_scene(1)
        left, right = scene.left, scene.right
    for name, row in measure(left, right, options.runs).items():
        print(f"{name:42s}" + "  ".join(f"{key} {value:8.2f}" for key, value in row.items()))


if __name__ == "__main__":
    main()
