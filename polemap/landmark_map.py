"""The pole map: landmarks in one earth frame behind a KD-tree."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from drivelog.errors import InputError
from drivelog.frames import EarthFrame

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PoleMap:
    """Poles of one earth frame; row i of every array is pole i.

    Attributes:
        frame: UTM zone or named local frame that the coordinates belong to.
        ids: `(n,)` stable identifiers.
        points_m: `(n, 2)` east, north of the axis at ground level.
        covariance_m2: `(n, 2, 2)`.
        width_m: `(n,)`, NaN where unknown.
        height_m: `(n,)`, NaN where unknown.
        observations: `(n,)` frames that saw it.
        drives: `(n,)` drives that saw it.
        existence: `(n,)` probability that it stands there, 0 to 1.

    Raises:
        InputError: arrays of unequal length or coordinates that are not finite.
    """

    frame: EarthFrame
    ids: NDArray[np.int64]
    points_m: Floats
    covariance_m2: Floats
    width_m: Floats
    height_m: Floats
    observations: NDArray[np.int64]
    drives: NDArray[np.int64]
    existence: Floats
    _tree: KDTree | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        n = len(self.ids)
        for name in ("points_m", "covariance_m2", "width_m", "height_m", "existence"):
            if len(getattr(self, name)) != n:
                raise InputError(f"pole map: {name} has {len(getattr(self, name))} rows, ids {n}")
        bad = np.flatnonzero(~np.isfinite(self.points_m).all(axis=1)) if n else np.array([])
        if len(bad):
            raise InputError(f"pole map: pole {self.ids[bad[0]]} has a position that is not finite")
        object.__setattr__(self, "_tree", KDTree(self.points_m) if n else None)

    def __len__(self) -> int:
        return len(self.ids)

    def within(self, centre_m: Floats, radius_m: float) -> NDArray[np.int64]:
        """Rows of the poles within `radius_m` of `centre_m`, `(2,)`, sorted."""
        if self._tree is None:
            return np.empty(0, dtype=np.int64)
        return np.sort(np.asarray(self._tree.query_ball_point(centre_m, radius_m), dtype=np.int64))
