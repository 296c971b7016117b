"""Where poles stand: beside a path, strewn about, and the map that a survey would make of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.drivelog.frames import EarthFrame
from polemap.map.pole_map import PoleMap

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Poles:
    """Poles on the ground.

    Attributes:
        points_m: `(n, 2)`.
        width_m: `(n,)`.
        visibility: `(n,)` factor of the detector's share, 1 for poles that are all alike.
    """

    points_m: Floats
    width_m: Floats
    visibility: Floats

    def __len__(self) -> int:
        return len(self.points_m)

    def rows(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Poles:
        """Some of them."""
        return Poles(self.points_m[rows], self.width_m[rows], self.visibility[rows])

    def joined(self, other: Poles) -> Poles:
        """These and then the others."""
        return Poles(
            np.concatenate([self.points_m, other.points_m]),
            np.concatenate([self.width_m, other.width_m]),
            np.concatenate([self.visibility, other.visibility]),
        )

    def changed(
        self, removed: NDArray[np.int64], added_m: Floats, moved_m: dict[int, Floats]
    ) -> Poles:
        """After works in the streets: some gone, some new at `(k, 2)`, some moved by `(2,)`."""
        points = self.points_m.copy()
        for row, by in moved_m.items():
            points[row] += by
        stay = np.setdiff1d(np.arange(len(points)), removed)
        n = len(added_m)
        new = Poles(added_m, np.full(n, 0.2), np.full(n, 0.8))
        return Poles(points, self.width_m, self.visibility).rows(stay).joined(new)

    def surveyed(self, frame: EarthFrame, sd_m: float, rng: np.random.Generator) -> PoleMap:
        """A map of them with independent errors of `sd_m` in each axis."""
        n = len(self)
        return PoleMap(
            frame=frame,
            ids=np.arange(n),
            points_m=self.points_m + sd_m * rng.standard_normal((n, 2)),
            covariance_m2=np.tile(np.eye(2) * sd_m**2, (n, 1, 1)),
            width_m=self.width_m,
            height_m=np.full(n, np.nan),
            observations=np.full(n, 20),
            drives=np.ones(n, dtype=np.int64),
            existence=np.ones(n),
        )


def roadside_poles(poses: Floats, spacing_m: float, rng: np.random.Generator) -> Poles:
    """Poles on both sides of a path `(n, 3)`; none within 2.5 m of it.

    Args:
        poses: the path, in steps of metres or less.
        spacing_m: mean way along it from one pole to the next, on both sides together.
        rng: all randomness.
    """
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    gaps = rng.gamma(2.0, spacing_m / 2.0, size=int(way[-1] / 2) + 10)
    station = np.cumsum(gaps) - 10.0
    station = station[station < way[-1]]
    row = np.clip(np.searchsorted(way, station), 0, len(poses) - 1)
    side = rng.choice([-1.0, 1.0], len(row)) * rng.uniform(3.5, 9.0, len(row))
    across = poses[row, 2] + np.pi / 2
    points = poses[row, :2] + side[:, None] * np.stack([np.cos(across), np.sin(across)], axis=1)
    clear = np.hypot(*(points[:, None] - poses[None, ::20, :2]).T).min(axis=0) > 2.5
    points = points[clear]
    return Poles(points, rng.uniform(0.08, 0.5, len(points)), np.ones(len(points)))


def scattered_poles(poses: Floats, per_m2: float, rng: np.random.Generator) -> Poles:
    """Poles strewn evenly over all that lies within 40 m east, north ... of a path `(n, 3)`.

    A strip of 3.5 m on both sides of the path is free of them.
    """
    low, high = poses[:, :2].min(axis=0) - 40.0, poses[:, :2].max(axis=0) + 40.0
    points = rng.uniform(low, high, (int(np.prod(high - low) * per_m2), 2))
    points = points[scipy.spatial.KDTree(poses[:, :2]).query(points)[0] > 3.5]
    return Poles(points, rng.uniform(0.1, 0.4, len(points)), np.ones(len(points)))
