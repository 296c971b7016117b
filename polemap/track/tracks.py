"""What the tracker takes and holds: sightings of a moment, tracks, and the motion between."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.samples import VisibleRegion

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Sighting:
    """What a detector saw at one moment, vehicle frame; one pole a row.

    Attributes:
        points_vehicle_m: `(n, 2)`.
        covariance_m2: `(n, 2, 2)`.
        width_m, height_m: `(n,)`, NaN where unknown.
        probability: `(n,)` of being a pole.
        view: where poles could have been seen, None if the detector does not say.
        per_offset_m: `(n, 2)` how the points move per unit of an error that all of them share;
            None where there is no such error. The covariance does not hold it.
    """

    stamp_s: float
    points_vehicle_m: Floats
    covariance_m2: Floats
    width_m: Floats
    height_m: Floats
    probability: Floats
    view: VisibleRegion | None
    per_offset_m: Floats | None = None


def _none() -> Floats:
    return np.empty(0)


@dataclass(frozen=True, slots=True)
class Tracks:
    """All tracks at one moment, vehicle frame; one a row.

    Attributes:
        ids: `(n,)`, never used twice.
        points_vehicle_m, covariance_m2: `(n, 2)`, `(n, 2, 2)`.
        width_m, width_var_m2: `(n,)`.
        height_m: `(n,)` running mean of the visible height, NaN where unknown.
        log_odds: `(n,)` of existence.
        hits: `(n,)` frames that saw it.
        born_s, seen_s: first and last stamp at which it was seen.
        confirmed: `(n,)`.
        detection: `(n,)` row of the detection that it took in the last update, -1 if none.
        per_offset_m: `(n, 2)` how the point moves per unit of the error that all detections share.
    """

    ids: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    points_vehicle_m: Floats = field(default_factory=lambda: np.empty((0, 2)))
    covariance_m2: Floats = field(default_factory=lambda: np.empty((0, 2, 2)))
    width_m: Floats = field(default_factory=_none)
    width_var_m2: Floats = field(default_factory=_none)
    height_m: Floats = field(default_factory=_none)
    log_odds: Floats = field(default_factory=_none)
    hits: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    born_s: Floats = field(default_factory=_none)
    seen_s: Floats = field(default_factory=_none)
    confirmed: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, dtype=bool))
    detection: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    per_offset_m: Floats = field(default_factory=lambda: np.empty((0, 2)))

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def existence(self) -> Floats:
        """`(n,)` probability that it is a pole."""
        return np.asarray(1.0 / (1.0 + np.exp(-self.log_odds)))

    def take(self, rows: Ints | NDArray[np.bool_]) -> Tracks:
        """The chosen rows."""
        return Tracks(*(getattr(self, name)[rows] for name in self.__slots__))

    def with_shared(self, variance: float) -> Tracks:
        """The same tracks, their covariance widened by what the shared error may be."""
        shared = self.per_offset_m[:, :, None] * self.per_offset_m[:, None, :]
        return with_changes(self, covariance_m2=self.covariance_m2 + variance * shared)


@dataclass(frozen=True, slots=True)
class Motion:
    """How the vehicle moved between two stamps: the later pose in the earlier one's frame."""

    dt_s: float
    forward_m: float
    left_m: float
    turn_rad: float
    distance_m: float


def with_changes(tracks: Tracks, **changes: object) -> Tracks:
    """The tracks with some columns in the place of theirs."""
    values = {name: changes.get(name, getattr(tracks, name)) for name in tracks.__slots__}
    return Tracks(**values)  # type: ignore[arg-type]


def concatenate(one: Tracks, two: Tracks) -> Tracks:
    """The rows of one, then those of the other."""
    return Tracks(
        *(np.concatenate([getattr(one, name), getattr(two, name)]) for name in one.__slots__)
    )
