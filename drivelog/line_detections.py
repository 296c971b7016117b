"""Straight pieces of lines that a detector saw at one moment: markings, kerbs, facades."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.columns import Columns
from polemap.drivelog.landmark_kind import LineStyle
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class LineDetections(Columns):
    """Pieces of lines in the vehicle frame; no rows are an observation, too.

    A piece says where the line lies across its direction and how it is turned. Where it begins and
    ends says nothing of the line: it is what was seen of it.

    Attributes:
        kind: `(n,)` a `LandmarkKind` of `LINE_KINDS`.
        style: `(n,)` a `LineStyle`.
        start_vehicle_m, end_vehicle_m: `(n, 2)` ends of the piece on the ground; of a kerb the
            upper edge, of a marking its middle, of a facade its foot.
        offset_sd_m: `(n,)` of the piece's middle across its direction, what is shared by all of
            the piece included.
        direction_sd_rad: `(n,)`.
        probability: `(n,)` of being a line of its kind.
    """

    kind: NDArray[np.int8]
    style: NDArray[np.int8]
    start_vehicle_m: Floats
    end_vehicle_m: Floats
    offset_sd_m: Floats
    direction_sd_rad: Floats
    probability: Floats

    @classmethod
    def none(cls) -> Self:
        """Of a detector that looked and saw no line."""
        whole, zero, points = np.empty(0, dtype=np.int8), np.empty(0), np.empty((0, 2))
        return cls(
            kind=whole,
            style=whole,
            start_vehicle_m=points,
            end_vehicle_m=points,
            offset_sd_m=zero,
            direction_sd_rad=zero,
            probability=zero,
        )

    @property
    def middle_vehicle_m(self) -> Floats:
        """Middles `(n, 2)`."""
        return 0.5 * (self.start_vehicle_m + self.end_vehicle_m)

    @property
    def length_m(self) -> Floats:
        """Lengths `(n,)`."""
        return np.asarray(np.hypot(*(self.end_vehicle_m - self.start_vehicle_m).T))

    @property
    def direction_rad(self) -> Floats:
        """Directions `(n,)` in the vehicle frame, from start to end, in (-pi, pi]."""
        along = self.end_vehicle_m - self.start_vehicle_m
        return np.asarray(wrap_angle(np.arctan2(along[:, 1], along[:, 0])))

    def of_kinds(self, *kinds: int) -> Self:
        """The rows of some kinds; the table itself where it holds no others."""
        mine = np.isin(self.kind, kinds)
        return self if mine.all() else self.take(mine)


def line_detections(
    kind: int, start_vehicle_m: Floats, end_vehicle_m: Floats, offset_sd_m: Floats,
    direction_sd_rad: Floats, *, probability: Floats | None = None, style: int = LineStyle.UNKNOWN,
) -> LineDetections:  # fmt: skip
    """Lines of one kind; see `LineDetections`. Probability is one where not given.

    Raises:
        InputError: columns of unequal length.
    """
    n = len(start_vehicle_m)
    return LineDetections(
        kind=np.full(n, kind, dtype=np.int8),
        style=np.full(n, style, dtype=np.int8),
        start_vehicle_m=np.asarray(start_vehicle_m, dtype=np.float64).reshape(-1, 2),
        end_vehicle_m=np.asarray(end_vehicle_m, dtype=np.float64).reshape(-1, 2),
        offset_sd_m=np.asarray(offset_sd_m, dtype=np.float64),
        direction_sd_rad=np.asarray(direction_sd_rad, dtype=np.float64),
        probability=np.ones(n) if probability is None else np.asarray(probability),
    )
