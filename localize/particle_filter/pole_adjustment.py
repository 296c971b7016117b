"""Robust least squares of sightings: some columns common to all, two more for each pole's place.

Each sighting is of one pole, so the normal equations are an arrow: a small block that all share,
and blocks of 2 x 2 along the diagonal. The poles are eliminated first.

Source: Triggs et al. (2000), "Bundle adjustment - a modern synthesis", section 6; Huber, Robust
Statistics, chapter 7; the scatter's factor as Birge (1932).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# of Huber's loss, in standard deviations of a detection; rounds of reweighting
_HUBER, _ROUNDS = 2.5, 3


@dataclass(frozen=True, slots=True)
class Sightings:
    """The linearized sightings of a stretch, whitened.

    Attributes:
        common: `(n, 2, c)` derivatives by what all share.
        place: `(n, 2, 2)` derivatives by the place of the sighting's pole.
        member: `(p, n)` one where a pole is the sighting's, else zero.
        target: `(n, 2)` what is seen less what is expected.
        share: `(n,)` of a sighting that is independent of others.
    """

    common: Floats
    place: Floats
    member: Floats
    target: Floats
    share: Floats
    _products: Floats  # (n, 2 c + 6): of place with common, place and target

    @classmethod
    def of(
        cls, common: Floats, place: Floats, member: Floats, target: Floats, share: Floats
    ) -> Sightings:
        """See the attributes."""
        n = len(target)
        turned = np.swapaxes(place, 1, 2)
        products = np.concatenate(
            [
                (np.swapaxes(common, 1, 2) @ place).reshape(n, -1),
                (turned @ place).reshape(n, -1),
                np.einsum("nba,na->nb", turned, target),
            ],
            axis=1,
        )
        return cls(common, place, member, target, share, products)

    def __len__(self) -> int:
        return len(self.target)

    def rows(self, kept: NDArray[np.bool_]) -> Sightings:
        """Some of the sightings."""
        return Sightings(
            self.common[kept], self.place[kept], self.member[:, kept], self.target[kept],
            self.share[kept], self._products[kept],
        )  # fmt: skip

    def with_columns(self, *columns: Floats) -> Sightings:
        """With further common columns `(n, 2)`."""
        common = np.concatenate([self.common, np.stack(columns, axis=2)], axis=2)
        return Sightings.of(common, self.place, self.member, self.target, self.share)

    def sums(self, factor: Floats) -> tuple[Floats, Floats, Floats]:
        """Products of a pole's place `(p, c, 2)`, `(p, 2, 2)`, `(p, 2)` with the common columns,
        itself and the target, summed over the sightings with factors `(n,)`."""
        poles, c = len(self.member), self.common.shape[2]
        total = (self.member * factor) @ self._products
        cross, own, pull = np.split(total, (2 * c, 2 * c + 4), axis=1)
        return cross.reshape(poles, c, 2), own.reshape(poles, 2, 2), pull


@dataclass(frozen=True, slots=True)
class Solution:
    """A robust solution.

    Attributes:
        values, covariance: `(c,)` and `(c, c)` of the common columns.
        weight: `(n,)` that the sightings had in the end.
        rest: `(n, 2)` residuals.
        scatter: of them, in stated standard deviations.
    """

    values: Floats
    covariance: Floats
    weight: Floats
    rest: Floats
    scatter: float
    _cross: Floats  # (p, c, 2)
    _spread: Floats  # (p, 2, 2): of the poles' places were the common columns known

    def variance_of(self, common: Floats, place: Floats) -> Floats:
        """Variance `(k,)` of sums of all columns.

        Args:
            common: `(k, c)` factors of the common columns.
            place: `(k, p, 2)` of the places of the poles.
        """
        own = np.einsum("pab,kpb->kpa", self._spread, place)
        passed = common - np.einsum("pca,kpa->kc", self._cross, own)
        return np.asarray(
            np.einsum("kpa,kpa->k", place, own)
            + np.einsum("kc,cd,kd->k", passed, self.covariance, passed)
        )


def solve(seen: Sightings, common_prior: Floats, place_prior: Floats) -> Solution:
    """Solve by reweighting; every column is expected to be zero with some information.

    Args:
        seen: at least one sighting.
        common_prior: `(c,)` information before the sightings.
        place_prior: `(p,)` of either axis of a pole's place.
    """
    n, _, c = seen.common.shape
    flat, target = seen.common.reshape(-1, c), seen.target.ravel()
    pole_prior = place_prior[:, None, None] * np.eye(2)
    weight, scatter = np.ones(n), 1.0
    for _ in range(_ROUNDS):
        factor = seen.share * weight
        cross, own, pull = seen.sums(factor)
        spread = np.asarray(np.linalg.inv(own + pole_prior), dtype=np.float64)
        pulled = np.einsum("pab,pb->pa", spread, pull)
        crossed = cross.transpose(1, 0, 2).reshape(c, -1)
        eliminated = (cross @ spread).transpose(1, 0, 2).reshape(c, -1)
        weighted = flat * np.repeat(factor, 2)[:, None]
        information = weighted.T @ flat + np.diag(common_prior) - eliminated @ crossed.T
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        values = covariance @ (weighted.T @ target - crossed @ pulled.ravel())
        places = pulled - (values @ eliminated).reshape(-1, 2)
        rest = (target - flat @ values).reshape(-1, 2)
        rest -= np.einsum("nab,nb->na", seen.place, seen.member.T @ places)
        size = np.hypot(*rest.T)
        weight = np.minimum(1.0, _HUBER / np.maximum(size, 1e-9))
        scatter = float(np.sqrt(0.5 * np.mean(np.minimum(size, 2.0 * _HUBER) ** 2)))
    return Solution(values, covariance, seen.share * weight, rest, scatter, cross, spread)
