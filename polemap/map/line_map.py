"""Lines of a map: markings, kerbs and facades as polylines with a deviation across.

A polyline says where the line lies across its direction; its ends are where it was last seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from polemap.drivelog.columns import Columns
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame, transform_points

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class LineSegments(Columns):
    """The straight pieces of all polylines, in their order.

    Attributes:
        line: `(s,)` row of the polyline.
        kind, style: `(s,)` of the polyline.
        start_m, end_m: `(s, 2)` east, north.
        sd_m: `(s,)` across, the larger one of both ends.
        existence: `(s,)`.
    """

    line: Rows
    kind: NDArray[np.int8]
    style: NDArray[np.int8]
    start_m: Floats
    end_m: Floats
    sd_m: Floats
    existence: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class LineMap(Columns):
    """Polylines of one earth frame; row i of every column is line i.

    Attributes:
        frame: of the coordinates.
        vertices_m: `(v, 2)` east, north of all vertices, line after line.
        vertex_sd_m: `(v,)` deviation across the line.
        ids: `(n,)` stable identifiers.
        kind: `(n,)` a `LandmarkKind` of `LINE_KINDS`.
        style: `(n,)` a `LineStyle`.
        count: `(n,)` vertices of each line, at least two.
        observations, drives: `(n,)` pieces that saw it, and drives.
        existence: `(n,)` probability that it is there, 0 to 1.

    Raises:
        InputError: columns of unequal length, counts that do not make up the vertices, or that
            are below two, vertices that are not finite.
    """

    HEADER: ClassVar[frozenset[str]] = frozenset(
        {"frame", "vertices_m", "vertex_sd_m", "_segments", "_tree"}
    )

    frame: EarthFrame
    vertices_m: Floats
    vertex_sd_m: Floats
    ids: Rows
    kind: NDArray[np.int8]
    style: NDArray[np.int8]
    count: Rows
    observations: Rows
    drives: Rows
    existence: Floats
    _segments: LineSegments | None = field(default=None, repr=False, compare=False)
    _tree: scipy.spatial.KDTree | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        Columns.__post_init__(self)
        needed = int(self.count.sum())
        if needed != len(self.vertices_m):
            raise InputError(
                f"line map: lines have {needed} vertices, {len(self.vertices_m)} are given"
            )
        if len(self.vertex_sd_m) != len(self.vertices_m):
            raise InputError(
                f"line map: {len(self.vertex_sd_m)} deviations for {len(self.vertices_m)} vertices"
            )
        short = np.flatnonzero(self.count < 2)
        if len(short):
            raise InputError(f"line map: line {self.ids[short[0]]} has less than two vertices")
        bad = np.flatnonzero(
            ~(np.isfinite(self.vertices_m).all(axis=1) & np.isfinite(self.vertex_sd_m))
        )
        if len(bad):
            line = self.ids[np.searchsorted(np.cumsum(self.count), bad[0], side="right")]
            raise InputError(f"line map: line {line} has a vertex that is not finite")

    @classmethod
    def empty(cls, frame: EarthFrame) -> Self:
        """A map without lines."""
        whole, small = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int8)
        return cls(
            frame=frame,
            vertices_m=np.empty((0, 2)),
            vertex_sd_m=np.empty(0),
            ids=whole,
            kind=small,
            style=small,
            count=whole,
            observations=whole,
            drives=whole,
            existence=np.empty(0),
        )

    @property
    def segments(self) -> LineSegments:
        """All straight pieces, made when they are first asked for."""
        if self._segments is None:
            line = np.repeat(np.arange(len(self)), self.count)
            inner = np.flatnonzero(line[1:] == line[:-1])
            owner, sd = line[inner], self.vertex_sd_m
            made = LineSegments(
                line=owner,
                kind=self.kind[owner],
                style=self.style[owner],
                start_m=self.vertices_m[inner],
                end_m=self.vertices_m[inner + 1],
                sd_m=np.maximum(sd[inner], sd[inner + 1]),
                existence=self.existence[owner],
            )
            object.__setattr__(self, "_segments", made)
        assert self._segments is not None
        return self._segments

    def within(self, centre_m: ArrayLike, radius_m: float) -> Rows:
        """Rows of `segments` that come within `radius_m` of `centre_m` `(2,)`, sorted."""
        pieces = self.segments
        if not len(pieces):
            return np.empty(0, dtype=np.int64)
        along = pieces.end_m - pieces.start_m
        half = 0.5 * np.hypot(*along.T)
        if self._tree is None:
            middles = 0.5 * (pieces.start_m + pieces.end_m)
            object.__setattr__(self, "_tree", scipy.spatial.KDTree(middles))
        assert self._tree is not None
        centre = np.asarray(centre_m, dtype=np.float64).reshape(2)
        reach = radius_m + float(half.max())
        near = np.array(self._tree.query_ball_point(centre, reach, return_sorted=True), np.int64)
        share = np.einsum("ij,ij->i", centre - pieces.start_m[near], along[near])
        share = np.clip(share / np.maximum(4.0 * half[near] ** 2, 1e-12), 0.0, 1.0)
        foot = pieces.start_m[near] + share[:, None] * along[near]
        return np.asarray(near[np.hypot(*(foot - centre).T) <= radius_m])

    def take(self, rows: slice | NDArray[np.bool_] | Rows) -> Self:
        """The chosen lines with their vertices."""
        first = np.concatenate([[0], np.cumsum(self.count)])
        chosen = np.arange(len(self))[rows]
        parts = [np.arange(first[row], first[row + 1]) for row in chosen]
        vertices = np.concatenate([np.empty(0, dtype=np.int64), *parts])
        return self.from_arrays(
            {name: values[rows] for name, values in self.arrays().items()},
            frame=self.frame,
            vertices_m=self.vertices_m[vertices],
            vertex_sd_m=self.vertex_sd_m[vertices],
        )

    def polyline_m(self, row: int) -> Floats:
        """Vertices `(count, 2)` of one line."""
        end = int(self.count[: row + 1].sum())
        return self.vertices_m[end - int(self.count[row]) : end]

    def to_frame(self, frame: EarthFrame) -> Self:
        """The same lines in another UTM zone; deviations keep, the scale differs by a thousandth.

        Raises:
            FrameError: one of the frames is local and the other is not the same.
        """
        if frame == self.frame:
            return self
        moved = transform_points(self.vertices_m, self.frame, frame)
        return replace(self, frame=frame, vertices_m=moved, _segments=None, _tree=None)


def join_lines(parts: Sequence[LineMap]) -> LineMap:
    """The lines of maps of one frame, one after the other."""
    joined = {
        name: np.concatenate([part.arrays()[name] for part in parts]) for name in parts[0].arrays()
    }
    return LineMap.from_arrays(
        joined,
        frame=parts[0].frame,
        vertices_m=np.concatenate([part.vertices_m for part in parts]),
        vertex_sd_m=np.concatenate([part.vertex_sd_m for part in parts]),
    )
