"""When to look elsewhere, and where: augmented Monte Carlo localization."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localize.config import LocalizeConfig
from localize.constellation import Candidates
from localize.gnss_alignment import GnssPose
from polemap.association import PoseLikelihoods

Floats = NDArray[np.float64]

_CANDIDATE_SD_M = 0.25
_CANDIDATE_SD_RAD = 0.02


def normalized_quality(result: PoseLikelihoods, weights: Floats) -> float:
    """How well the matched poles fit, 0 to 1, whatever their number: the k-th root of the
    likelihood of k matched poles, averaged over the particles.

    The likelihood is taken relative to that of a perfect match, so that poles far away, which are
    measured less sharply, do not look like a bad fit.

    Source: Spangenberg (2016), section IV-C.
    """
    return float(weights @ np.exp(result.log_fit / np.maximum(result.matched, 1)))


class LikelihoodAverages:
    """Short- and long-term average of the quality; their ratio is the call for exploration.

    Source: Thrun, Burgard, Fox (2005), table 8.3.
    """

    def __init__(self, config: LocalizeConfig) -> None:
        self._config = config
        self._short: float | None = None
        self._long: float | None = None

    def update(self, quality: float) -> None:
        """Take in the quality of one scan that could say something."""
        if self._short is None or self._long is None:
            self._short = self._long = quality
            return
        self._short += self._config.likelihood_short * (quality - self._short)
        self._long += self._config.likelihood_long * (quality - self._long)

    @property
    def share(self) -> float:
        """Share of the particles that should be drawn anew, 0 to `explore_share_max`."""
        if self._short is None or self._long is None or self._long <= 0.0:
            return 0.0
        missing = 1.0 - self._short / (self._config.explore_margin * self._long)
        return float(np.clip(missing, 0.0, self._config.explore_share_max))

    def settle(self) -> None:
        """After new particles came in: the short average starts again from the long one."""
        self._short = self._long

    def reset(self) -> None:
        """Forget both."""
        self._short = self._long = None


def draw_poses(
    count: int,
    gnss: GnssPose | None,
    candidates: Candidates,
    rng: np.random.Generator,
    *,
    candidate_share: float = 0.6,
) -> Floats:
    """Rear-axle poses `(count, 3)` from where the car may be; fewer (or none) if nothing is known.

    Constellation matches are drawn by how many poles they explain, the rest around GNSS.
    """
    from_candidates = 0
    if len(candidates):
        from_candidates = count if gnss is None else round(candidate_share * count)
    parts = [np.empty((0, 3))]
    if from_candidates:
        odds = np.exp(1.5 * (candidates.score - candidates.score.max()))
        chosen = rng.choice(len(candidates), size=from_candidates, p=odds / odds.sum())
        spread = np.array([_CANDIDATE_SD_M, _CANDIDATE_SD_M, _CANDIDATE_SD_RAD])
        noise = rng.standard_normal((from_candidates, 3)) * spread
        parts.append(candidates.poses[chosen] + noise)
    if gnss is not None and count > from_candidates:
        parts.append(gnss.sample(count - from_candidates, rng))
    return np.vstack(parts)
