"""How right disparities are, on pairs with ground truth.

    python -m benchmarks.stereo_accuracy FOLDER... [--curve PICTURE.png] [--calibrate] [--every N]

A FOLDER is a KITTI 2015 or 2012 `training` folder (or the one above it) or one with Middlebury
scenes (teddy, cones: `*02.png`, `*06.png` and `disp*02.png`); without one the rendered poles are
scored. OpenCV's variants stand beside the census matcher. `--curve` trades density against error
by margin, speckle size and uniqueness and draws that, `--calibrate` prints the tables of
stereo/error_model.py.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.stereo_pairs import Pair, read_pairs
from benchmarks.stereo_scenes import PoleScore, rendered_scene, score_poles
from stereo.checks import without_speckles
from stereo.config import OpenCvConfig, StereoConfig
from stereo.error_model import OUTLIER_PX, DisparityErrorModel, texture
from stereo.matching import StereoMatcher, make_matcher

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


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


def rate(pairs: list[Pair], maps: list[NDArray[np.float32]]) -> dict[str, float]:
    """Error and density over all pairs, on non-occluded pixels (each counts once)."""
    wrong = known = valid = 0
    for pair, disparity in zip(pairs, maps, strict=True):
        truth = pair.non_occluded()
        found = truth & np.isfinite(disparity)
        wrong += int((pair.wrong(disparity) & found).sum())
        known += int(found.sum())
        valid += int(truth.sum())
    return {
        "error_percent": 100 * wrong / max(known, 1),
        "density_percent": 100 * known / max(valid, 1),
    }


def score(matcher: StereoMatcher, pairs: list[Pair]) -> dict[str, float]:
    """`rate` of a matcher's left maps, and its time."""
    times, maps = [], []
    for pair in pairs:
        start = time.perf_counter()
        maps.append(matcher.match(pair.left, pair.right).left)
        times.append(1e3 * (time.perf_counter() - start))
    return {**rate(pairs, maps), "median_ms": float(np.median(times))}


SPECKLES_PX = (0, 100, 400, 1500)
MARGINS = (0, 2, 5, 10, 20, 30, 45, 60, 80)
UNIQUENESS_PERCENT = (0, 10, 25)


def curves(pairs: list[Pair]) -> dict[str, list[tuple[float, float]]]:
    """`(density, error)` in percent: the census matcher by speckle size and by least margin, and
    each of OpenCV's variants by uniqueness, without and with the same speckle filter.
    """
    found: dict[str, list[tuple[float, float]]] = {}

    def add(name: str, maps: list[NDArray[np.float32]]) -> None:
        row = rate(pairs, maps)
        found.setdefault(name, []).append((row["density_percent"], row["error_percent"]))

    def left_maps(config: StereoConfig, **change: int) -> list[NDArray[np.float32]]:
        matcher = make_matcher(config.model_copy(update=change))
        return [matcher.match(pair.left, pair.right).left for pair in pairs]

    default = StereoConfig()
    for name, config in variants().items():
        for percent in UNIQUENESS_PERCENT if config.matcher == "opencv_sgbm" else ():
            maps = left_maps(config, uniqueness_percent=percent, speckle_px=0)
            for size in (0, default.speckle_px):
                cleaned = [without_speckles(m, size, default.speckle_step_px) for m in maps]
                add(f"{name}, speckles {size}", cleaned)
    for size in SPECKLES_PX:
        add("census by speckle size", left_maps(default, speckle_px=size))
    found["census by margin"] = curve(make_matcher(default), pairs)
    return found


def draw_curves(found: dict[str, list[tuple[float, float]]], path: Path) -> None:
    """Density to the right, error upwards."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 6))
    axes = figure.subplots()
    for name, points in found.items():
        ours = name.startswith("census")
        density, error = zip(*points, strict=True)
        label = name if ours or "speckles 0" not in name else None
        colour = "tab:red" if ours else ("tab:blue" if "speckles 0" not in name else "0.75")
        axes.plot(density, error, "o-" if ours else ".-", color=colour, lw=2 if ours else 0.8)
        axes.annotate(label or "", points[0], fontsize=6)
    axes.plot([92, 92, 100], [0, 3.5, 3.5], "k--", lw=0.8)
    axes.set(xlabel="density [%]", ylabel="error [%]", xlim=(60, 100), ylim=(0, 12))
    figure.savefig(path, dpi=120)


def curve(matcher: StereoMatcher, pairs: list[Pair]) -> list[tuple[float, float]]:
    """`(density, error)` in percent as the smallest margin of the winner rises.

    Raises:
        SystemExit: a matcher without margins.
    """
    margins, wrongs, valid = [], [], 0
    for pair in pairs:
        maps = matcher.match(pair.left, pair.right)
        if maps.left_margin is None:
            raise SystemExit(f"{matcher.name} has no margins to draw a curve by")
        truth = pair.non_occluded()
        found = truth & np.isfinite(maps.left)
        margins.append(maps.left_margin[found])
        wrongs.append(pair.wrong(maps.left)[found])
        valid += int(truth.sum())
    margin, wrong = np.concatenate(margins), np.concatenate(wrongs)
    rows = []
    for limit in MARGINS:
        keep = margin >= limit
        rows.append((100 * keep.sum() / valid, 100 * wrong[keep].mean()))
    return rows


def calibrate(matcher: StereoMatcher, pairs: list[Pair]) -> DisparityErrorModel:
    """The tables of the error model from the pairs, on the grids of the model in use."""
    model = DisparityErrorModel()
    greys, margins, errors = [], [], []
    for pair in pairs:
        maps = matcher.match(pair.left, pair.right)
        found = np.isfinite(pair.truth) & np.isfinite(maps.left)
        greys.append(texture(pair.left)[found])
        assert maps.left_margin is not None
        margins.append(maps.left_margin[found])
        errors.append(np.abs(maps.left - pair.truth)[found])
    grey, margin, error = map(np.concatenate, (greys, margins, errors))
    rows = np.digitize(grey, np.sqrt(model.texture_grid[1:] * model.texture_grid[:-1]))
    columns = np.digitize(margin, (model.margin_grid[1:] + model.margin_grid[:-1]) / 2)
    sd, outliers = model.sd_px_table.copy(), model.outlier_table.copy()
    for i in range(sd.shape[0]):
        for j in range(sd.shape[1]):
            cell = error[(rows == i) & (columns == j)]
            if len(cell) > 200:
                sd[i, j] = np.sqrt(np.mean(cell[cell < OUTLIER_PX] ** 2))
                outliers[i, j] = np.mean(cell >= OUTLIER_PX)
    return DisparityErrorModel(model.texture_grid, model.margin_grid, sd, outliers)


def score_rendered(config: StereoConfig, seeds: range, **scene: float) -> dict[str, float]:
    """Poles of `benchmarks/stereo_scenes.py`, both views."""
    matcher = make_matcher(config)
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
    for side, total in zip(("left", "right"), sums, strict=True):
        row[f"{side}_recall"] = total.recall
        row[f"{side}_thin_recall"] = total.thin_recall
        row[f"{side}_fattening_px"] = total.fattening_px
    return row


def _show(name: str, row: dict[str, float]) -> None:
    print(f"{name:32s}" + "  ".join(f"{key} {value:.3f}" for key, value in row.items()), flush=True)


def run() -> dict[str, dict[str, float]]:
    """For `python -m benchmarks`: the default matcher and OpenCV's on what this machine has."""
    results = {}
    chosen = {name: config for name, config in variants().items() if name.startswith("census")}
    chosen["opencv 3way none 5 16"] = variants()["opencv 3way none 5 16"]
    for folder in ("kitti_2015", "middlebury"):
        pairs = list(read_pairs(SHARED / folder)) if (SHARED / folder).exists() else []
        for name, config in chosen.items() if pairs else ():
            results[f"{folder} {name}"] = score(make_matcher(config), pairs)
    for name, config in chosen.items():
        small = config.model_copy(update={"disparities": 64})
        results[f"rendered poles {name}"] = score_rendered(small, range(8))
    return results


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--curve", type=Path, metavar="PICTURE.png")
    parser.add_argument("--calibrate", action="store_true")
    parser.add_argument("--every", type=int, default=1, help="only every Nth pair")
    options = parser.parse_args()
    np.set_printoptions(precision=2, suppress=True, linewidth=140)
    for folder in options.folders:
        pairs = list(read_pairs(folder))[:: options.every]
        if not pairs:
            raise SystemExit(f"{folder}: neither KITTI nor Middlebury pairs with ground truth")
        if options.calibrate:
            model = calibrate(make_matcher(StereoConfig()), pairs)
            print(model.sd_px_table, model.outlier_table, sep="\n")
            continue
        for name, config in variants().items():
            matcher = make_matcher(config)
            _show(f"{folder.name} {name}", score(matcher, pairs))
            if name == "census" and len(pairs) > 3:
                for half in (0, 1):
                    _show(f"{folder.name} {name}, half {half + 1}", score(matcher, pairs[half::2]))
        if options.curve is not None:
            found = curves(pairs)
            for name, points in found.items():
                print(name, *(f"{error:.2f}@{density:.1f}" for density, error in points))
            draw_curves(found, options.curve)
    if options.folders:
        return
    for name, config in variants(64).items():
        _show(f"poles {name}", score_rendered(config, range(8)))
    default = StereoConfig(disparities=64)
    for change in ({}, {"gain": 0.7}, {"gamma": 1.3}, {"vignetting": 0.4}, {"noise_sd": 4.0}):
        _show(f"poles {change or 'as they are'}", score_rendered(default, range(4), **change))
    for bits in (12, 16):
        config = StereoConfig(disparities=64, uint16_bits=bits)
        _show(f"poles {bits} bit", score_rendered(config, range(4), bits=bits))


if __name__ == "__main__":
    main()
