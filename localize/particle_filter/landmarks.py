"""What a scan's poles are held against: the map's poles around the car as arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.map.pole_map import PoleMap

Floats = NDArray[np.float64]

FACING_COLUMN = "facing_rad"
"""Extra column of a map: the free side of its corners, counter-clockwise from grid east."""
_LARGEST_DETECTION = 0.999


@dataclass(frozen=True, slots=True)
class Landmarks:
    """The map poles around the car, as plain arrays.

    Attributes:
        kind: `(m,)` a `LandmarkKind`.
        points_m: `(m, 2)` east, north.
        covariance_m2: `(m, 3)` var east, var north, covariance.
        width_m: `(m,)`, NaN where unknown.
        detection: `(m,)` probability that a pole in view is reported, in (0, 1).
        ids: `(m,)` of the map's poles, whatever part of the map is loaded.
        facing_rad: `(m,)` of corners, counter-clockwise from east, NaN where unknown; None of a
            map that knows no sides.
    """

    kind: NDArray[np.int8]
    points_m: Floats
    covariance_m2: Floats
    width_m: Floats
    detection: Floats
    ids: NDArray[np.int64]
    facing_rad: Floats | None = None

    @classmethod
    def of(
        cls,
        pole_map: PoleMap,
        p_detection: float,
        rows: NDArray[np.int64] | None = None,
        *,
        uncertain: bool = True,
        doubtful: bool = True,
    ) -> Landmarks:
        """Some poles of a map, or all.

        Args:
            uncertain: whether they have the map's covariance, or none.
            doubtful: whether one that may no longer stand is expected less.
        """
        if rows is None:
            rows = np.arange(len(pole_map))
        covariance = pole_map.covariance_m2.reshape(-1, 2, 2)[rows]
        existence = np.clip(pole_map.existence[rows], 0.05, 1.0) if doubtful else np.ones(len(rows))
        if not uncertain:
            covariance = np.zeros_like(covariance)
        facing = pole_map.extra.get(FACING_COLUMN)
        return cls(
            pole_map.kind[rows],
            np.ascontiguousarray(pole_map.points_m.reshape(-1, 2)[rows]),
            np.stack([covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 0, 1]], axis=1),
            np.asarray(pole_map.width_m[rows], dtype=np.float64),
            np.minimum(p_detection * existence, _LARGEST_DETECTION),
            np.asarray(pole_map.ids[rows], dtype=np.int64),
            None if facing is None else np.asarray(facing[rows], dtype=np.float64),
        )

    def take(self, rows: NDArray[np.bool_]) -> Landmarks:
        """Those of a mask `(m,)`."""
        columns = {field.name: getattr(self, field.name) for field in fields(self)}
        chosen: dict[str, Any] = {
            name: None if v is None else v[rows] for name, v in columns.items()
        }
        return replace(self, **chosen)

    def __len__(self) -> int:
        return len(self.ids)
