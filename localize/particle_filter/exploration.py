"""When to look elsewhere, and where: augmented Monte Carlo localization."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.localize.gnss.alignment import GnssPose
from polemap.localize.particle_filter.constellation import LOG_ODDS_A_POLE, Candidates
from polemap.localize.particle_filter.sensor_model import PoseLikelihoods

Floats = NDArray[np.float64]

# times of the two averages, and the ratio of the short one to the long one below which exploring
# begins; our choice, as the book leaves them open
_SHORT_S, _LONG_S = 1.0, 20.0
_FULL_WEIGHT_POLES = 4.0
_CANDIDATE_SD_M = 0.25
_CANDIDATE_SD_RAD = 0.02
_CHANCE_SCORE = 1.5  # two poles of the street fit somewhere near


@dataclass(frozen=True, slots=True)
class Quality:
    """How well a scan fits, 0 to 1, and how many matches were possible (its weight)."""

    value: float
    possible: float


def normalized_quality(result: PoseLikelihoods, weights: Floats, seen: int) -> Quality:
    """The k-th root of the likelihood of k matched poles, averaged over the particles.

    The likelihood is taken relative to that of a perfect match, so that poles far away, which are
    measured less sharply, do not look like a bad fit; and times the share of the possible matches
    that exist, so that a single chance match does not look like a good one.

    Source: Spangenberg (2016), section IV-C.
    """
    matched = result.matched
    possible = np.maximum(np.minimum(result.expected, seen), matched)
    share = matched / np.maximum(possible, 1.0)
    value = weights @ (share * np.exp(result.log_fit / np.maximum(matched, 1)))
    return Quality(float(value), float(weights @ possible))


def plain_quality(result: PoseLikelihoods, weights: Floats, seen: int) -> Quality:
    """The k-th root of the likelihood of k matched poles as it stands, the particles' mean.

    Every scan that sees a pole counts in full.

    Source: Spangenberg (2016), section IV-C; Thrun, Burgard, Fox (2005), table 8.3.
    """
    value = weights @ np.exp(result.log_likelihood / np.maximum(result.matched, 1))
    return Quality(float(value), _FULL_WEIGHT_POLES if seen else 0.0)


class LikelihoodAverages:
    """Short- and long-term average of the quality; their ratio is the call for exploration.

    Args:
        share_max: largest share of the particles that is drawn anew.
        margin: ratio below which that begins.

    Source: Thrun, Burgard, Fox (2005), table 8.3, with a margin of 1.
    """

    def __init__(self, share_max: float, margin: float) -> None:
        self._share_max, self._margin = share_max, margin
        self._short = self._long = 0.0
        self._age_s = 0.0
        self._last_s = -np.inf

    def add_quality(self, stamp_s: float, quality: Quality) -> None:
        """Take in the quality of one scan; one that could match little counts little."""
        elapsed = min(stamp_s - self._last_s, _SHORT_S)
        self._last_s = stamp_s
        # an average over what there was so far, until it has the length it should have
        elapsed *= min(quality.possible / _FULL_WEIGHT_POLES, 1.0)
        if elapsed <= 0.0:
            return
        self._age_s += elapsed
        for_short = min(_SHORT_S, self._age_s)
        for_long = min(_LONG_S, self._age_s)
        self._short += -np.expm1(-elapsed / for_short) * (quality.value - self._short)
        self._long += -np.expm1(-elapsed / for_long) * (quality.value - self._long)

    @property
    def share(self) -> float:
        """Share of the particles that should be drawn anew, 0 to `share_max`."""
        if self._age_s < _SHORT_S or self._long <= 0.0:
            return 0.0
        missing = 1.0 - self._short / (self._margin * self._long)
        return float(np.clip(missing, 0.0, self._share_max))

    def reset(self) -> None:
        """Forget both."""
        self._short = self._long = self._age_s = 0.0


def draw_poses(
    count: int,
    gnss: GnssPose | None,
    candidates: Candidates,
    rng: np.random.Generator,
    *,
    candidate_share: float = 0.8,
) -> Floats:
    """Rear-axle poses `(count, 3)` from where the car may be; fewer (or none) if nothing is known.

    Constellation matches are drawn by their score, the rest around GNSS. `candidate_share` at most
    are matches, and less where the best of them is no better than chance.
    """
    from_candidates = 0
    if len(candidates):
        odds = np.exp(LOG_ODDS_A_POLE * (candidates.score - candidates.score.max()))
        chance = np.exp(LOG_ODDS_A_POLE * (_CHANCE_SCORE - candidates.score.max()))
        share = min(candidate_share, float(odds.sum() / (odds.sum() + chance)))
        from_candidates = count if gnss is None else round(share * count)
    parts = [np.empty((0, 3))]
    if from_candidates:
        chosen = rng.choice(len(candidates), size=from_candidates, p=odds / odds.sum())
        least = np.diag(np.square([_CANDIDATE_SD_M, _CANDIDATE_SD_M, _CANDIDATE_SD_RAD]))
        root = np.linalg.cholesky(candidates.covariance + least)
        noise = rng.standard_normal((from_candidates, 3))
        parts.append(candidates.poses[chosen] + np.einsum("nij,nj->ni", root[chosen], noise))
    if gnss is not None and count > from_candidates:
        parts.append(gnss.sample(count - from_candidates, rng))
    return np.vstack(parts)
