"""Error against density: what each matcher has wrong when its least trusted disparities go.

    python -m benchmarks.stereo.curves FOLDER PICTURE.png

All matchers alike: without and with the speckle filter, thinned by the law of stereo/trust.py.
Its coefficients are fitted to each matcher's own maps on every second pair and order those of the
other half, and the other way round. OpenCV's variants are drawn by their uniqueness test as well,
the census matcher by its margin.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.stereo.pairs import Pair, Variant, read_pairs, variants
from polemap.stereo.checks import SPECKLE_STEP_PX, without_speckles
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import DisparityPair
from polemap.stereo.trust import OFFSET_LEAST_PX, TrustLaw, column_offset_px, disagreement_px

DENSITIES = (93, 92, 91, 90, 89, 88, 86, 84, 82, 80, 78, 75, 70)
MARGINS = (0, 2, 5, 10, 20, 30, 45, 60, 80)
UNIQUENESS_PERCENT = (0, 10, 25)
SPECKLES_PX = (0, StereoConfig().speckle_px)

Points = list[tuple[float, float]]


@dataclass(frozen=True, slots=True)
class Signs:
    """Of the disparities at known pixels of one pair.

    Attributes:
        disagreement_px, offset_px: `(n,)` the signs of trust.
        wrong: `(n,)` whether it is an error.
        valid: known pixels, with or without a disparity.
    """

    disagreement_px: NDArray[np.float32]
    offset_px: NDArray[np.float32]
    wrong: NDArray[np.bool_]
    valid: int


def signs(pair: Pair, maps: DisparityPair) -> Signs:
    """The signs of trust of the left map where truth is known."""
    truth = pair.non_occluded()
    found = truth & np.isfinite(maps.left)
    assert maps.right_unchecked is not None
    return Signs(
        disagreement_px(maps.left, maps.right_unchecked, -1)[found],
        column_offset_px(maps.left)[found],
        pair.wrong(maps.left)[found],
        int(truth.sum()),
    )


def fitted_law(samples: list[Signs]) -> TrustLaw:
    """The logistic law of the samples that is most likely."""
    from sklearn.linear_model import LogisticRegression

    disagreement = np.concatenate([s.disagreement_px for s in samples])
    offset = np.concatenate([s.offset_px for s in samples])
    rows = np.stack([disagreement, np.log(offset + OFFSET_LEAST_PX)], axis=1).astype(np.float64)
    fit = LogisticRegression(C=1e6).fit(rows, np.concatenate([s.wrong for s in samples]))
    return TrustLaw(float(fit.intercept_[0]), *(float(value) for value in fit.coef_[0]))


def crossed_chances(samples: list[Signs]) -> list[NDArray[np.float32]]:
    """Outlier chances of every pair, by the law of the half that it does not belong to."""
    laws = [fitted_law(samples[half::2]) for half in (0, 1)]
    return [
        laws[1 - number % 2].chance(sample.disagreement_px, sample.offset_px)
        for number, sample in enumerate(samples)
    ]


def at_densities(
    chance: NDArray[np.float32], wrong: NDArray[np.bool_], valid: int, densities: tuple[float, ...]
) -> Points:
    """`(density, error)` in percent of all, and of the most trusted of each density below."""
    order = np.argsort(chance, kind="stable")
    errors = np.cumsum(wrong[order])
    counts = [int(density / 100 * valid) for density in densities]
    counts = [len(wrong), *(count for count in counts if 0 < count < len(wrong))]
    return [(100 * count / valid, 100 * float(errors[count - 1]) / count) for count in counts]


def by_trust(samples: list[Signs]) -> Points:
    """Thinned by the crossed law, over all pairs together."""
    return at_densities(
        np.concatenate(crossed_chances(samples)),
        np.concatenate([s.wrong for s in samples]),
        sum(s.valid for s in samples),
        DENSITIES,
    )


def as_it_is(samples: list[Signs]) -> tuple[float, float]:
    """`(density, error)` in percent."""
    wrong = np.concatenate([s.wrong for s in samples])
    return 100 * len(wrong) / sum(s.valid for s in samples), 100 * float(wrong.mean())


def by_margin(pairs: list[Pair], maps: list[DisparityPair]) -> Points:
    """The census matcher as the smallest margin of the winner rises."""
    margins, wrongs, valid = [], [], 0
    for pair, found in zip(pairs, maps, strict=True):
        truth = pair.non_occluded()
        known = truth & np.isfinite(found.left)
        assert found.left_margin is not None
        margins.append(found.left_margin[known])
        wrongs.append(pair.wrong(found.left)[known])
        valid += int(truth.sum())
    margin, wrong = np.concatenate(margins), np.concatenate(wrongs)
    keeps = (margin >= limit for limit in MARGINS)
    return [(100 * keep.sum() / valid, 100 * float(wrong[keep].mean())) for keep in keeps]


def _cleaned(maps: DisparityPair, size: int) -> DisparityPair:
    left = without_speckles(maps.left, size, SPECKLE_STEP_PX)
    return replace(maps, left=left)


def _census(name: str, variant: Variant, pairs: list[Pair]) -> Iterator[tuple[str, Points]]:
    for size in SPECKLES_PX:
        matcher = variant.matcher(speckle_px=size)
        maps = [matcher.match(pair.left, pair.right) for pair in pairs]
        samples = [signs(*both) for both in zip(pairs, maps, strict=True)]
        yield f"{name}, speckles {size}, by trust", by_trust(samples)
        if size == variant.config.speckle_px:
            yield f"{name}, speckles {size}, by margin", by_margin(pairs, maps)


def _opencv(name: str, variant: Variant, pairs: list[Pair]) -> Iterator[tuple[str, Points]]:
    own: dict[int, Points] = {size: [] for size in SPECKLES_PX}
    for percent in UNIQUENESS_PERCENT:
        change = {"uniqueness_percent": percent, "speckle_px": 0}
        matcher = variant.matcher(**change)
        maps = [matcher.match(pair.left, pair.right) for pair in pairs]
        for size in SPECKLES_PX:
            cleaned = [_cleaned(found, size) for found in maps]
            samples = [signs(*both) for both in zip(pairs, cleaned, strict=True)]
            own[size].append(as_it_is(samples))
            if percent < max(UNIQUENESS_PERCENT):
                label = f"{name}, uniqueness {percent}, speckles {size}, by trust"
                yield label, by_trust(samples)
    for size, points in own.items():
        yield f"{name}, speckles {size}, by uniqueness", points


def curves(pairs: list[Pair]) -> Iterator[tuple[str, Points]]:
    """Name and `(density, error)` in percent of every matcher and way of thinning."""
    for name, variant in variants().items():
        if variant.config.matcher == "census_sgm":
            yield from _census(name, variant, pairs)
        else:
            yield from _opencv(name, variant, pairs)


def draw(found: dict[str, Points], path: Path) -> None:
    """Density to the right, error upwards; OpenCV thinned by trust left, by uniqueness right.

    Dotted: without the speckle filter.
    """
    from matplotlib.figure import Figure

    families = (
        ("census,", "tab:red", "census"),
        ("opencv 3way none 5", "tab:blue", "OpenCV 3WAY, block 5"),
        ("opencv 3way none 3", "tab:cyan", "OpenCV 3WAY, block 3"),
        ("opencv 3way clahe", "tab:green", "OpenCV 3WAY behind CLAHE"),
        ("opencv", "0.7", "OpenCV's other modes, ranks, census bytes"),
    )
    figure = Figure(figsize=(13, 6))
    both = figure.subplots(1, 2, sharey=True)
    for name, points in found.items():
        family = next((f for f in families if name.startswith(f[0])), None)
        if family is None or name.endswith("by margin"):
            continue
        ours, density, error = family is families[0], *zip(*points, strict=True)
        style = ":" if "speckles 0" in name else "-"
        for axes, wanted in zip(both, ("by trust", "by uniqueness"), strict=True):
            if name.endswith(wanted) or ours:
                width = 2.0 if ours else 1.0
                axes.plot(density, error, style, marker=".", color=family[1], lw=width)
    for axes, title in zip(both, ("all thinned by trust", "OpenCV by uniqueness"), strict=True):
        axes.plot([92, 92, 100], [0, 3.5, 3.5], "k--", lw=0.8, label="asked for")
        for _, colour, label in families:
            axes.plot([], [], color=colour, label=label)
        axes.set(title=title, xlabel="density [%]", xlim=(69, 95), ylim=(0, 6))
        axes.grid(alpha=0.3)
    both[0].legend(loc="upper left", fontsize=8)
    both[0].set_ylabel("over 3 px and 5 % [% of the disparities]")
    figure.tight_layout()
    figure.savefig(path, dpi=70)


def main(folder: Path, picture: Path) -> None:
    """Print and draw the curves of the pairs in `folder`."""
    pairs = list(read_pairs(folder))
    if len(pairs) < 2:
        raise SystemExit(f"{folder}: needs at least two pairs with ground truth")
    found = {}
    for name, points in curves(pairs):
        found[name] = points
        print(name, *(f"{error:.2f}@{density:.1f}" for density, error in points), flush=True)
    draw(found, picture)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]))
