"""What the census matcher would have scored, had its penalties been chosen on other pairs.

    python -m benchmarks.stereo.holdout FOLDER

A small grid of penalties. Each half of the pairs (1, 3, 5 ... and 2, 4, 6 ...) chooses the one with
the least error at one density, thinned by stereo/trust.py to what every setting reaches on that
half; the other half is the judge. Twice: by the pairs alone, and only among settings that find
nearly as many pole pixels (rendered streets 4 to 7) as the best.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.stereo.accuracy import score_rendered
from benchmarks.stereo.curves import Signs, at_densities, signs
from benchmarks.stereo.pairs import Pair, Variant, read_pairs
from polemap.stereo.config import Penalties, StepPenalty, StereoConfig
from polemap.stereo.matching import make_matcher
from polemap.stereo.trust import LAWS

P1 = (3, 5, 8)
ACROSS = ((110, 4.0), (110, 8.0), (150, 12.0), (180, 20.0))  # gamma, alpha
UPRIGHT_P2_MAX = (80, 120)
STREETS = range(4, 8)
POLE_LOSS = 0.005


@dataclass(frozen=True, slots=True)
class Candidate:
    """One setting, with the signs of every pair, and recall of pole pixels, all and thin ones."""

    penalties: Penalties
    samples: list[Signs]
    recall: float
    thin_recall: float

    def at_density(self, half: int, density: float) -> float:
        """Error in percent of that half at `density`, of the most trusted disparities."""
        parts = self.samples[half::2]
        law = LAWS["census_sgm"]
        chance = np.concatenate([law.chance(s.disagreement_px, s.offset_px) for s in parts])
        wrong = np.concatenate([s.wrong for s in parts])
        return at_densities(chance, wrong, sum(s.valid for s in parts), (density,))[-1][1]

    def as_it_is(self, half: slice) -> tuple[int, int, int]:
        """Errors, disparities and known pixels of the pairs of `half`."""
        parts = self.samples[half]
        return (
            sum(int(s.wrong.sum()) for s in parts),
            sum(len(s.wrong) for s in parts),
            sum(s.valid for s in parts),
        )

    def density(self, half: int) -> float:
        """In percent."""
        _, found, valid = self.as_it_is(slice(half, None, 2))
        return 100 * found / valid


def candidates(pairs: list[Pair]) -> list[Candidate]:
    """Every setting of the grid, scored."""
    shipped, found = Penalties(), []
    for p1, (gamma, alpha), upright in product(P1, ACROSS, UPRIGHT_P2_MAX):
        across = StepPenalty(
            p2_min=max(p1, shipped.across.p2_min),
            p2_max=shipped.across.p2_max,
            gamma=gamma,
            alpha=alpha,
        )
        law = shipped.upright.model_copy(update={"p2_max": upright})
        penalties = Penalties(p1=p1, across=across, upright=law)
        config = StereoConfig(penalties=penalties)
        matcher = make_matcher(config)
        samples = [signs(pair, matcher.match(pair.left, pair.right)) for pair in pairs]
        poles = score_rendered(Variant(config), STREETS)
        recall, thin = (
            (poles[f"left{k}"] + poles[f"right{k}"]) / 2 for k in ("_recall", "_thin_recall")
        )
        found.append(Candidate(penalties, samples, recall, thin))
    return found


def _text(candidate: Candidate, half: slice) -> str:
    wrong, found, valid = candidate.as_it_is(half)
    return f"{100 * wrong / found:.2f} % at {100 * found / valid:.2f} % density"


def _name(penalties: Penalties) -> str:
    across, upright = penalties.across, penalties.upright
    return f"p1 {penalties.p1}, across {across.gamma} / {across.alpha}, upright {upright.p2_max}"


def main(folder: Path) -> None:
    """Print both choices, what the other half says of them, and the crossed total."""
    pairs = list(read_pairs(folder))
    if len(pairs) < 2:
        raise SystemExit(f"{folder}: needs at least two pairs with ground truth")
    every = candidates(pairs)
    densities = [min(one.density(half) for one in every) for half in (0, 1)]
    for one in every:
        errors = (f"{one.at_density(half, densities[half]):.2f}" for half in (0, 1))
        poles = f"poles {one.recall:.3f}, thin {one.thin_recall:.3f}"
        print(_name(one.penalties), *errors, _text(one, slice(None)), poles, sep="; ")
    best_recall = max(one.recall for one in every)
    for label, least in (("pairs alone", 0.0), ("poles kept", best_recall - POLE_LOSS)):
        allowed = [one for one in every if one.recall >= least]
        total = np.zeros(3)
        for half in (0, 1):
            chosen = min(allowed, key=lambda one: one.at_density(half, densities[half]))
            judge = slice(1 - half, None, 2)
            total += chosen.as_it_is(judge)
            print(
                f"{label}, half {half + 1} chooses {_name(chosen.penalties)}: other half", end=" "
            )
            print(_text(chosen, judge))
        print(f"{label}, crossed: {100 * total[0] / total[1]:.2f} %", end=" ")
        print(f"at {100 * total[1] / total[2]:.2f} % density", flush=True)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]))
