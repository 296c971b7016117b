"""Lines and corners along a street as they truly are, and the map that a survey makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle
from polemap.map.line_map import LineMap
from polemap.map.pole_map import KIND_COLUMN, PoleMap, join_maps
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]

FACING_COLUMN = "facing_rad"
_STEP_M = 0.5
_VERTEX_EVERY = 10  # steps between vertices of a surveyed line: five metres


@dataclass(frozen=True, slots=True)
class StreetLine:
    """One line.

    Attributes:
        kind, style: a `LandmarkKind` and a `LineStyle`.
        points_m: `(n, 2)` along it, half a metre apart.
        seen: `(n,)` whether there is paint, or an edge, at each point.
    """

    kind: LandmarkKind
    style: LineStyle
    points_m: Floats
    seen: NDArray[np.bool_]

    def moved(self, by_m: float, from_m: float, to_m: float) -> StreetLine:
        """The line after it was painted anew `by_m` to the left over a part of its length."""
        station = np.arange(len(self.points_m)) * _STEP_M
        turned = by_m * ((station >= from_m) & (station < to_m))
        return replace(self, points_m=self.points_m + turned[:, None] * left_of(self.points_m))


@dataclass(frozen=True, slots=True)
class Corners:
    """Edges of houses: points `(n, 2)` with the direction `(n,)` of their free side."""

    points_m: Floats
    facing_rad: Floats

    def __len__(self) -> int:
        return len(self.facing_rad)

    def surveyed(
        self, frame: EarthFrame, sd_m: float, first_id: int, rng: np.random.Generator
    ) -> PoleMap:
        """A map of them with independent errors of `sd_m` in each axis."""
        n = len(self)
        kind = np.full(n, LandmarkKind.CORNER, dtype=np.int8)
        return PoleMap(
            frame=frame,
            ids=first_id + np.arange(n),
            points_m=self.points_m + sd_m * rng.standard_normal((n, 2)),
            covariance_m2=np.tile(np.eye(2) * sd_m**2, (n, 1, 1)),
            width_m=np.full(n, np.nan),
            height_m=np.full(n, np.nan),
            observations=np.full(n, 20),
            drives=np.ones(n, dtype=np.int64),
            existence=np.ones(n),
            extra={KIND_COLUMN: kind, FACING_COLUMN: np.asarray(self.facing_rad)},
        )


@dataclass(frozen=True, slots=True)
class Repaint:
    """Markings painted anew after the survey: `by_m` to the left from way to way."""

    by_m: float
    from_m: float = 0.0
    to_m: float = np.inf


@dataclass(frozen=True, slots=True)
class Street:
    """What lines and corners accompany a path that runs in the middle of its right lane.

    Attributes:
        lane_width_m: of both lanes.
        centre: style of the line between them.
        edge_lines, kerbs: whether both edges have them; a kerb stands `kerb_gap_m` outside of the
            lane's edge.
        dash_m, gap_m: of a dashed line.
        wander_m: sd by which lines depart from the path, slowly.
        house_spacing_m: mean way from one house to the next on each side; infinite without any.
        house_m: width of a house.
        setback_m: least and most distance of a front from the path's lane's outer edge.
        map_sd_m: of the surveyed map, across lines and in each axis of corners; along a line
            errors last for some 20 m.
        repaint: markings painted anew since the survey.
    """

    lane_width_m: float = 3.5
    centre: LineStyle = LineStyle.DASHED
    edge_lines: bool = True
    kerbs: bool = True
    kerb_gap_m: float = 0.5
    dash_m: float = 3.0
    gap_m: float = 6.0
    wander_m: float = 0.1
    house_spacing_m: float = 22.0
    house_m: tuple[float, float] = (8.0, 15.0)
    setback_m: tuple[float, float] = (3.0, 7.0)
    map_sd_m: float = 0.05
    repaint: Repaint | None = None

    def lines(self, path_m: Floats, rng: np.random.Generator) -> tuple[StreetLine, ...]:
        """Lines beside a path `(n, 2)`."""
        path = evenly(path_m)
        if len(path) < 2:
            return ()
        path = path + (self.wander_m * _slow(len(path), 80.0, rng))[:, None] * left_of(path)
        half, whole = self.lane_width_m / 2, self.lane_width_m
        right, left = -half, half + whole
        solid, plain = LineStyle.SOLID, LineStyle.UNKNOWN
        marking, kerb = LandmarkKind.LANE_MARKING, LandmarkKind.KERB
        chosen = [(half, marking, self.centre)]
        chosen += [(at, marking, solid) for at in (right, left)] if self.edge_lines else []
        gap = self.kerb_gap_m
        chosen += [(at, kerb, plain) for at in (right - gap, left + gap)] if self.kerbs else []
        return tuple(self._line(path, *one) for one in chosen)

    def _line(self, path: Floats, at_m: float, kind: LandmarkKind, style: LineStyle) -> StreetLine:
        station = np.arange(len(path)) * _STEP_M
        seen = np.ones(len(path), dtype=np.bool_)
        if style is LineStyle.DASHED:
            seen = np.mod(station, self.dash_m + self.gap_m) <= self.dash_m
        return StreetLine(kind, style, path + at_m * left_of(path), seen)

    def corners(self, path_m: Floats, rng: np.random.Generator) -> Corners:
        """Corners of the houses on both sides of a path `(n, 2)`, on the street's front."""
        path, points, facing = evenly(path_m), [], []
        normal = left_of(path)
        for side in (1.0, -1.0):
            edge = self.lane_width_m * (1.5 if side > 0 else 0.5)
            station = float(rng.uniform(0.0, 10.0))
            while np.isfinite(self.house_spacing_m):
                width = float(rng.uniform(*self.house_m))
                away = side * (edge + float(rng.uniform(*self.setback_m)))
                spare = max(self.house_spacing_m - float(np.mean(self.house_m)), 0.5)
                row = int(station / _STEP_M), int((station + width) / _STEP_M)
                station += width + float(rng.uniform(0.5, 2.0 * spare - 0.5 if spare > 0.5 else 1))
                if row[1] >= len(path):
                    break
                begin, end = (path[k] + away * normal[k] for k in row)
                along = float(np.arctan2(*(end - begin)[::-1]))
                points += [begin, end]
                facing += [along + np.pi, along]
        kept = np.array(points).reshape(-1, 2)
        # where the path comes back, houses would stand on the road
        clear = [np.hypot(*(path - point).T).min() > self.lane_width_m for point in kept]
        rows = np.array(clear, dtype=np.bool_)
        return Corners(kept[rows], np.asarray(wrap_angle(np.array(facing)))[rows])

    def repainted(self, lines: Sequence[StreetLine]) -> tuple[StreetLine, ...]:
        """The lines as they are after the survey."""
        paint = self.repaint
        if paint is None:
            return tuple(lines)
        return tuple(
            line.moved(paint.by_m, paint.from_m, paint.to_m)
            if line.kind == LandmarkKind.LANE_MARKING else line
            for line in lines
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class StreetTruth:
    """What truly accompanies a street: lines and corners."""

    lines: tuple[StreetLine, ...] = ()
    corners: Corners = field(default_factory=lambda: Corners(np.empty((0, 2)), np.empty(0)))

    def onto(
        self, pole_map: PoleMap, sd_m: float, rng: np.random.Generator
    ) -> PoleMap:  # fmt: skip
        """A map of poles with a survey of these on top."""
        first = int(pole_map.ids.max()) + 1 if len(pole_map) else 0
        joined = pole_map
        if len(self.corners):
            surveyed = self.corners.surveyed(pole_map.frame, sd_m, first, rng)
            none = {FACING_COLUMN: np.full(len(pole_map), np.nan)}
            poles = replace(pole_map, extra={**pole_map.extra, **none})
            joined = join_maps(poles, surveyed)
        if not self.lines:
            return joined
        return replace(joined, lines=surveyed_lines(self.lines, pole_map.frame, sd_m, rng))


def surveyed_lines(
    lines: Sequence[StreetLine], frame: EarthFrame, sd_m: float, rng: np.random.Generator
) -> LineMap:
    """A map of lines with errors of `sd_m` across, which last for some 20 m along."""
    vertices, count = [], []
    for line in lines:
        rows = np.unique([*range(0, len(line.points_m), _VERTEX_EVERY), len(line.points_m) - 1])
        error = sd_m * _slow(len(rows), 20.0 / (_VERTEX_EVERY * _STEP_M), rng)
        vertices.append(line.points_m[rows] + error[:, None] * left_of(line.points_m)[rows])
        count.append(len(rows))
    n = len(lines)
    points = np.concatenate([np.empty((0, 2)), *vertices])
    return LineMap(
        frame=frame,
        vertices_m=points,
        vertex_sd_m=np.full(len(points), max(sd_m, 1e-3)),
        ids=np.arange(n),
        kind=np.array([line.kind for line in lines], dtype=np.int8),
        style=np.array([line.style for line in lines], dtype=np.int8),
        count=np.array(count, dtype=np.int64),
        observations=np.full(n, 20),
        drives=np.ones(n, dtype=np.int64),
        existence=np.ones(n),
    )


def evenly(path_m: Floats) -> Floats:
    """Points of a path `(n, 2)` every half metre of its length."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path_m, axis=0).T))])
    moved = np.concatenate([[True], np.diff(way) > 1e-6])
    at = np.arange(0.0, way[-1], _STEP_M)
    return np.stack([np.interp(at, way[moved], path_m[moved, k]) for k in (0, 1)], axis=1)


def left_of(path_m: Floats) -> Floats:
    """Unit vectors `(n, 2)` to the left of a path."""
    if len(path_m) < 2:
        return np.zeros_like(path_m)
    ahead = np.gradient(path_m, axis=0)
    length = np.maximum(np.hypot(*ahead.T), 1e-9)
    return np.asarray(np.stack([-ahead[:, 1], ahead[:, 0]], axis=1) / length[:, None])


def _slow(count: int, steps: float, rng: np.random.Generator) -> Floats:
    """Unit noise `(count,)` that is alike over so many steps."""
    keep = np.exp(-1.0 / steps)
    kick = rng.standard_normal(count) * np.sqrt(1.0 - keep**2)
    kick[:1] /= np.sqrt(1.0 - keep**2)
    out, state = np.empty(count), 0.0
    for k in range(count):
        state = keep * state + kick[k]
        out[k] = state
    return out
