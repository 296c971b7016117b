"""What a detector saw at one moment: the one table from the detector to the map and the filters.

The column `kind` names the class of a row (`landmark_kind.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polemap.drivelog.columns import Columns
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.line_detections import LineDetections

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class VisibleRegion:
    """The part of the ground in which a sensor could have seen a pole at one moment.

    A sector around `origin_vehicle_m`, `(2,)` in the vehicle frame, from `bearing_min_rad` to
    `bearing_max_rad` (counter-clockwise from forward). `free_range_m`, `(k,)`, is the range up to
    which nothing stood before a pole, in k equal bins over the sector, right to left; a single
    bin serves a sensor that does not know occlusion.
    """

    origin_vehicle_m: Floats
    bearing_min_rad: float
    bearing_max_rad: float
    range_min_m: float
    free_range_m: Floats

    @property
    def sees_nothing(self) -> bool:
        """Whether no pole could have been seen: another detector looked, one of lines, say."""
        return not bool(np.max(self.free_range_m) > self.range_min_m)

    def contains(self, points_vehicle_m: Floats) -> NDArray[np.bool_]:
        """Which of the points `(..., 2)` could have been seen; `(...,)`."""
        offset = np.asarray(points_vehicle_m, dtype=np.float64) - self.origin_vehicle_m
        bearing = np.arctan2(offset[..., 1], offset[..., 0])
        distance = np.hypot(offset[..., 0], offset[..., 1])
        bins = len(self.free_range_m)
        span = self.bearing_max_rad - self.bearing_min_rad
        column = np.floor((bearing - self.bearing_min_rad) / span * bins).astype(np.int64)
        inside = (column >= 0) & (column < bins) & (distance >= self.range_min_m)
        return inside & (distance <= self.free_range_m[np.clip(column, 0, bins - 1)])


NOTHING_IN_VIEW = VisibleRegion(np.zeros(2), -np.pi, np.pi, 1.0, np.zeros(1))
"""Of a moment at which no detector of poles looked."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Detections(Columns):
    """Landmarks detected at one moment, vehicle frame; no rows are an observation, too.

    Attributes:
        stamp_s, arrival_s: when it was measured, and when it reached the computer.
        view: where a landmark would have been detected, or None if the sensor does not say.
        lines: pieces of lines that were seen, or None of a detector that looks for none.
        kind: `(n,)` a `LandmarkKind`.
        points_vehicle_m: `(n, 2)` axis at ground level; of a corner its edge.
        covariance_m2: `(n, 2, 2)`, without the error that `shift_per_px_m` tells of.
        width_m: `(n,)`, NaN where unknown.
        height_m: `(n,)` visible height over the ground, NaN where unknown.
        probability: `(n,)` of being a landmark of its kind; after tracking, of the track's.
        track_id: `(n,)`, -1 where it belongs to no track.
        shift_per_px_m: `(n, 2)` how the point moves when all disparities grow by one pixel; zero
            where no stereo camera measured it or its shared error is not considered.
        facing_rad: `(n,)` of a corner, counter-clockwise from forward: from its edge into the
            free side, away from what it bounds; NaN where the kind has none.
        parts: `(n,)` of what it consists: 1, or the number of stakes round one sapling.
    """

    HEADER: ClassVar[frozenset[str]] = frozenset({"stamp_s", "arrival_s", "view", "lines"})

    stamp_s: float
    arrival_s: float
    view: VisibleRegion | None = None
    lines: LineDetections | None = None
    kind: NDArray[np.int8]
    points_vehicle_m: Floats
    covariance_m2: Floats
    width_m: Floats
    height_m: Floats
    probability: Floats
    track_id: NDArray[np.int64]
    shift_per_px_m: Floats
    facing_rad: Floats
    parts: NDArray[np.int64]

    def of_kinds(self, *kinds: int) -> Self:
        """The rows of some kinds; the table itself where it holds no others."""
        # asked of every scan, of which nearly all are of one kind
        if set(kinds).issuperset(self.kind.tolist()):
            return self
        return self.take(np.isin(self.kind, kinds))


def pole_view(scans: Sequence[Detections]) -> VisibleRegion | None:
    """What the detector of poles behind scans could see: of the first at which it looked."""
    views = (scan.view for scan in scans)
    return next((view for view in views if view is not None and not view.sees_nothing), None)


def pole_detections(
    stamp_s: float,
    arrival_s: float,
    points_vehicle_m: ArrayLike,
    covariance_m2: ArrayLike,
    *,
    width_m: ArrayLike | None = None,
    height_m: ArrayLike | None = None,
    probability: ArrayLike | None = None,
    track_id: ArrayLike | None = None,
    view: VisibleRegion | None = None,
) -> Detections:
    """Poles detected at one moment; see `Detections`.

    Args:
        points_vehicle_m, covariance_m2: `(n, 2)`, `(n, 2, 2)`.
        width_m, height_m: `(n,)`, unknown where not given.
        probability: `(n,)`, one where not given.
        track_id: `(n,)`, none where not given.

    Raises:
        InputError: columns of unequal length.
    """
    points = np.asarray(points_vehicle_m, dtype=np.float64).reshape(-1, 2)
    n = len(points)

    def column(values: ArrayLike | None, default: float) -> Floats:
        return np.full(n, default) if values is None else np.asarray(values, dtype=np.float64)

    return Detections(
        stamp_s=stamp_s,
        arrival_s=arrival_s,
        view=view,
        kind=np.full(n, LandmarkKind.POLE, dtype=np.int8),
        points_vehicle_m=points,
        covariance_m2=np.asarray(covariance_m2, dtype=np.float64).reshape(-1, 2, 2),
        width_m=column(width_m, np.nan),
        height_m=column(height_m, np.nan),
        probability=column(probability, 1.0),
        track_id=(
            np.full(n, -1, dtype=np.int64)
            if track_id is None
            else np.asarray(track_id, dtype=np.int64)
        ),
        shift_per_px_m=np.zeros((n, 2)),
        facing_rad=np.full(n, np.nan),
        parts=np.ones(n, dtype=np.int64),
    )
