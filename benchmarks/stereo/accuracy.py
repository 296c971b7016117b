"""How right disparities are, on pairs with ground truth.

    python -m benchmarks.stereo.accuracy FOLDER... [--calibrate] [--every N]

A FOLDER is a KITTI 2015 or 2012 `training` folder (or the one above it), a KITTI raw folder with
LiDAR depth in `depth/`, or one with Middlebury scenes (teddy, cones: `*02.png`, `*06.png` and
`disp*02.png`); without one the rendered poles are scored. OpenCV's variants stand beside the
census matcher. `--calibrate` prints the laws of stereo/trust.py. `python -m
benchmarks.stereo.curves` trades density against error.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import RECORDINGS, command_line
from benchmarks.stereo.curves import fitted_law, signs
from benchmarks.stereo.pairs import Pair, Variant, read_pairs, variants
from benchmarks.stereo.scenes import PoleScore, rendered_scene, score_poles
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import StereoMatcher, make_matcher
from polemap.stereo.trust import TrustLaw


def rate(pairs: list[Pair], maps: list[NDArray[np.float32]]) -> dict[str, float]:
    """Error and density over all pairs, on non-occluded pixels (each counts once).

    With Middlebury's pairs also the error where half-occluded ones count, too.
    """

    def counts(pair: Pair, disparity: NDArray[np.float32], mask: NDArray[np.bool_]) -> list[int]:
        found = mask & np.isfinite(disparity)
        return [int((pair.wrong(disparity) & found).sum()), int(found.sum()), int(mask.sum())]

    both = list(zip(pairs, maps, strict=True))
    wrong, found, valid = np.sum([counts(p, d, p.non_occluded()) for p, d in both], axis=0)
    row = {
        "error_percent": 100 * wrong / max(found, 1),
        "density_percent": 100 * found / max(valid, 1),
    }
    if not all(pair.kitti for pair in pairs):
        wrong, found, _ = np.sum([counts(p, d, np.isfinite(p.truth)) for p, d in both], axis=0)
        row["all_error_percent"] = 100 * wrong / max(found, 1)
    return {name: float(value) for name, value in row.items()}


def score(matcher: StereoMatcher, pairs: list[Pair]) -> dict[str, float]:
    """`rate` of a matcher's left maps, and its time."""
    times, maps = [], []
    for pair in pairs:
        start = time.perf_counter()
        maps.append(matcher.match(pair.left, pair.right).left)
        times.append(1e3 * (time.perf_counter() - start))
    return {**rate(pairs, maps), "median_ms": float(np.median(times))}


def trust_laws(pairs: list[Pair]) -> dict[str, TrustLaw]:
    """The law of stereo/trust.py fitted to both matchers' maps of the pairs."""
    found = {}
    for config in (StereoConfig(), StereoConfig(matcher="opencv_sgbm")):
        matcher = make_matcher(config)
        samples = [signs(pair, matcher.match(pair.left, pair.right)) for pair in pairs]
        found[matcher.name] = fitted_law(samples)
    return found


def score_rendered(variant: Variant, seeds: range, **scene: float) -> dict[str, float]:
    """Poles of `benchmarks/stereo/scenes.py`, both views."""
    matcher = variant.matcher(disparities=64)
    sums = [PoleScore(), PoleScore()]
    wrong = known = 0
    for seed in seeds:
        pair = rendered_scene(seed, **scene)  # type: ignore[arg-type]
        maps = matcher.match(pair.left, pair.right)
        for side, disparity in enumerate((maps.left, maps.right)):
            sums[side] = sums[side] + score_poles(pair, disparity, side)
            found = np.isfinite(disparity)
            known += int(found.sum())
            wrong += int((np.abs(disparity - pair.views[side].disparity_px) > 1)[found].sum())
    row = {"error_percent": 100 * wrong / known}
    for view, total in zip(("left", "right"), sums, strict=True):
        row[f"{view}_recall"] = total.recall
        row[f"{view}_thin_recall"] = total.thin_recall
        row[f"{view}_clear_recall"] = total.clear_recall
        row[f"{view}_fattening_px"] = total.fattening_px
    return row


def _show(name: str, row: dict[str, float]) -> None:
    print(f"{name:32s}" + "  ".join(f"{key} {value:.3f}" for key, value in row.items()), flush=True)


def run() -> dict[str, dict[str, float]]:
    """For `python -m benchmarks`: the default matcher and OpenCV's on what this machine has."""
    results = {}
    chosen = {name: variant for name, variant in variants().items() if name.startswith("census")}
    chosen["opencv 3way none 5 16"] = variants()["opencv 3way none 5 16"]
    for folder in ("kitti_2015", "kitti_raw", "middlebury"):
        pairs = list(read_pairs(RECORDINGS / folder)) if (RECORDINGS / folder).exists() else []
        for name, variant in chosen.items() if pairs else ():
            results[f"{folder} {name}"] = score(variant.matcher(), pairs)
    for name, variant in chosen.items():
        results[f"rendered poles {name}"] = score_rendered(variant, range(8))
    return results


def main() -> None:
    """The command line."""
    # every Nth pair
    options = command_line(__doc__, paths="folders", calibrate=False, every=1)
    np.set_printoptions(precision=2, suppress=True, linewidth=140)
    for folder in options.folders:
        pairs = list(read_pairs(folder))[:: options.every]
        if not pairs:
            raise SystemExit(f"{folder}: neither KITTI nor Middlebury pairs with ground truth")
        if options.calibrate:
            print(*trust_laws(pairs).items(), sep="\n")
            continue
        for name, variant in variants().items():
            matcher = variant.matcher()
            _show(f"{folder.name} {name}", score(matcher, pairs))
            if name == "census" and len(pairs) > 3:
                for half in (0, 1):
                    _show(f"{folder.name} {name}, half {half + 1}", score(matcher, pairs[half::2]))
    if options.folders:
        return
    for name, variant in variants().items():
        _show(f"poles {name}", score_rendered(variant, range(8)))
    default = Variant(StereoConfig())
    for change in ({}, {"gain": 0.7}, {"gamma": 1.3}, {"vignetting": 0.4}, {"noise_sd": 4.0}):
        _show(f"poles {change or 'as they are'}", score_rendered(default, range(4), **change))
    for bits in (12, 16):
        variant = Variant(StereoConfig(uint16_bits=bits))
        _show(f"poles {bits} bit", score_rendered(variant, range(4), bits=bits))


if __name__ == "__main__":
    main()
