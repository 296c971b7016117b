"""The pole map: poles in one earth frame behind a KD-tree."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from polemap.drivelog.detections import VisibleRegion
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame, transform_points
from polemap.drivelog.landmark_kind import kind_counts
from polemap.map.line_map import LineMap, join_lines
from polemap.vehicle.packed import transform_point
from polemap.vehicle.pose import rotate_back

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

KIND_COLUMN = "landmark_kind"
FACING_COLUMN = "facing_rad"
_SAME_LENGTH = (
    "points_m", "covariance_m2", "width_m", "height_m", "observations", "drives", "existence",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class PoleMap:
    """Poles of one earth frame; row i of every array is pole i. Arrays are made read-only.

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
        extra: further columns `(n,)`, kept by every format (evidence, history; `landmark_kind`
            where not all rows are poles).
        notes: what a user of the map must know (a frame that was assumed, say).
        doubtful: poles that were removed, or that await proof; kept for the next update only.
        lines: markings, kerbs and facades of the same frame, or None of a map that knows none.

    Raises:
        InputError: arrays of unequal length, coordinates or covariances that are not finite,
            existence outside 0 to 1, kinds that are no whole numbers from 0 to 127.
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
    extra: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    doubtful: PoleMap | None = None
    lines: LineMap | None = None
    _tree: scipy.spatial.KDTree | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        n = len(self.ids)
        for name in _SAME_LENGTH:
            if len(getattr(self, name)) != n:
                raise InputError(f"pole map: {name} has {len(getattr(self, name))} rows, ids {n}")
        for name, values in self.extra.items():
            if len(values) != n:
                raise InputError(f"pole map: column {name} has {len(values)} rows, ids {n}")
        if n:
            self._check_values()
        for array in (self.ids, *(getattr(self, name) for name in _SAME_LENGTH)):
            array.setflags(write=False)

    def _check_values(self) -> None:
        bad = np.flatnonzero(~np.isfinite(self.points_m).all(axis=1))
        if len(bad):
            raise InputError(f"pole map: pole {self.ids[bad[0]]} has a position that is not finite")
        bad = np.flatnonzero(~np.isfinite(self.covariance_m2).all(axis=(1, 2)))
        if len(bad):
            raise InputError(f"pole map: pole {self.ids[bad[0]]} has a covariance with a NaN")
        bad = np.flatnonzero(~((self.existence >= 0.0) & (self.existence <= 1.0)))
        if len(bad):
            value = self.existence[bad[0]]
            raise InputError(f"pole map: pole {self.ids[bad[0]]} has existence {value}, not 0 to 1")
        if KIND_COLUMN in self.extra:
            bad = np.flatnonzero(~np.isin(self.extra[KIND_COLUMN], np.arange(128)))
            if len(bad):
                raise InputError(
                    f"pole map: pole {self.ids[bad[0]]} has the {KIND_COLUMN} "
                    f"{self.extra[KIND_COLUMN][bad[0]]}, not a whole number from 0 to 127"
                )
            kind = np.asarray(self.extra[KIND_COLUMN], dtype=np.int8)
            object.__setattr__(self, "extra", {**self.extra, KIND_COLUMN: kind})

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def empty(cls, frame: EarthFrame) -> PoleMap:
        """A map without poles."""
        none, whole = np.empty(0), np.empty(0, dtype=np.int64)
        return cls(
            frame, whole, np.empty((0, 2)), np.empty((0, 2, 2)), none, none.copy(), whole.copy(),
            whole.copy(), none.copy(),
        )  # fmt: skip

    @property
    def kind(self) -> NDArray[np.int8]:
        """Class `(n,)` of every row, a `LandmarkKind`; all poles where the map does not say."""
        column = self.extra.get(KIND_COLUMN)
        return np.broadcast_to(np.int8(0), len(self)) if column is None else column

    @property
    def described(self) -> str:
        """How many landmarks of each kind it holds, as in "12 poles, 3 kerbs"."""
        kinds = [kind_counts(self.kind) or "0 poles"]
        if self.lines is not None and len(self.lines):
            kinds.append(kind_counts(self.lines.kind))
        return ", ".join(kinds)

    @property
    def tree(self) -> scipy.spatial.KDTree | None:
        """The index over `points_m`, built when it is first asked for; None without poles."""
        if self._tree is None and len(self):
            # splitting at the middle builds several times faster, and poles are spread evenly
            # enough along streets for queries to stay as quick
            tree = scipy.spatial.KDTree(
                self.points_m, balanced_tree=False, compact_nodes=False, leafsize=16
            )
            object.__setattr__(self, "_tree", tree)
        return self._tree

    def within(self, centre_m: ArrayLike, radius_m: float) -> Rows:
        """Rows of the poles within `radius_m` of `centre_m`, `(2,)`, sorted."""
        tree = self.tree
        if tree is None:
            return np.empty(0, dtype=np.int64)
        centre = np.asarray(centre_m, dtype=np.float64).reshape(2)
        return np.array(tree.query_ball_point(centre, radius_m, return_sorted=True), np.int64)

    def nearest(self, points_m: ArrayLike, limit_m: float = np.inf) -> tuple[Floats, Rows]:
        """Distance and row of the nearest pole of each point `(m, 2)`.

        Infinite distance and row -1 where none lies within `limit_m`.
        """
        points = np.asarray(points_m, dtype=np.float64).reshape(-1, 2)
        tree = self.tree
        if tree is None:
            return np.full(len(points), np.inf), np.full(len(points), -1, dtype=np.int64)
        distance, row = tree.query(points, distance_upper_bound=limit_m)
        return np.asarray(distance), np.where(np.isfinite(distance), row, -1).astype(np.int64)

    def in_view(self, pose: ArrayLike, view: VisibleRegion) -> Rows:
        """Rows of the poles that a sensor at a vehicle pose `(3,)` could see, sorted."""
        east, north, yaw = (float(value) for value in np.asarray(pose))
        centre = transform_point((east, north, yaw), *view.origin_vehicle_m)
        rows = self.within(centre, float(np.max(view.free_range_m)))
        in_vehicle = rotate_back(self.points_m[rows] - (east, north), yaw)
        return rows[view.contains(in_vehicle)]

    def rows(self, rows: ArrayLike | slice) -> PoleMap:
        """A map of some rows (indices, a mask, a slice)."""
        chosen = rows if isinstance(rows, slice) else np.asarray(rows)
        return replace(
            self,
            ids=self.ids[chosen],
            **{name: getattr(self, name)[chosen] for name in _SAME_LENGTH},
            extra={name: values[chosen] for name, values in self.extra.items()},
            _tree=None,
        )

    def lean(self) -> PoleMap:
        """The same map with 4-byte numbers where metres do not need 8; for whole cities."""
        return replace(
            self,
            covariance_m2=self.covariance_m2.astype(np.float32),
            width_m=self.width_m.astype(np.float32),
            height_m=self.height_m.astype(np.float32),
            observations=self.observations.astype(np.int32),
            drives=self.drives.astype(np.int32),
            existence=self.existence.astype(np.float32),
        )

    @property
    def bytes_per_pole(self) -> float:
        """Memory of the columns a pole, without the index."""
        arrays = [self.ids, *(getattr(self, name) for name in _SAME_LENGTH), *self.extra.values()]
        return float(sum(array.nbytes for array in arrays)) / max(len(self), 1)

    def to_frame(self, frame: EarthFrame) -> PoleMap:
        """The same poles in another UTM zone; covariances are turned and scaled along.

        Raises:
            FrameError: one of the frames is local and the other is not the same.
        """
        if frame == self.frame:
            return self
        points = transform_points(self.points_m, self.frame, frame)
        # one metre is short enough for the difference to be the derivative
        east = transform_points(self.points_m + np.array([1.0, 0.0]), self.frame, frame)
        north = transform_points(self.points_m + np.array([0.0, 1.0]), self.frame, frame)
        jacobian = np.stack([east - points, north - points], axis=-1)
        covariance = jacobian @ self.covariance_m2 @ jacobian.transpose(0, 2, 1)
        note = f"transformed from {self.frame} to {frame}"
        return replace(
            self,
            frame=frame,
            points_m=points,
            covariance_m2=covariance,
            notes=(*self.notes, note),
            doubtful=self.doubtful.to_frame(frame) if self.doubtful is not None else None,
            lines=self.lines.to_frame(frame) if self.lines is not None else None,
            _tree=None,
        )


def join_maps(*maps: PoleMap) -> PoleMap:
    """The rows of maps of one frame, one after the other; extra columns that all have, and the
    kind."""
    first = maps[0]

    def all_of(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(one, name) for one in maps])

    extra = {
        name: np.concatenate([one.extra[name] for one in maps])
        for name in first.extra
        if all(name in one.extra for one in maps)
    }
    if any(KIND_COLUMN in one.extra for one in maps):
        extra[KIND_COLUMN] = all_of("kind")
    lines = [one.lines for one in maps if one.lines is not None]
    return PoleMap(
        frame=first.frame,
        ids=all_of("ids"),
        points_m=all_of("points_m"),
        covariance_m2=all_of("covariance_m2"),
        width_m=all_of("width_m"),
        height_m=all_of("height_m"),
        observations=all_of("observations"),
        drives=all_of("drives"),
        existence=all_of("existence"),
        extra=extra,
        notes=tuple(note for one in maps for note in one.notes),
        lines=join_lines(lines) if lines else None,
    )
