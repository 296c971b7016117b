"""Streets of points with markings, kerbs and corners beside the poles, seen with stated errors.

The lines run beside the path of a drive of points; what a detector sees of them is drawn from
errors of which a part lasts and another is shared by all pieces of a frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle
from polemap.drivelog.line_detections import LineDetections
from polemap.map.line_map import LineMap
from polemap.map.pole_map import KIND_COLUMN, PoleMap, join_maps
from polemap.simulate.config import DetectorConfig
from polemap.simulate.detector import PoleDetector
from polemap.simulate.points.drive import PointDrive, PointScenario, sensed, simulate_points
from polemap.simulate.points.poles import Poles
from polemap.vehicle.pose import inverse_transform_points, wrap_angle

Floats = NDArray[np.float64]

_STEP_M = 3.0
_NO_POLES = Poles(np.empty((0, 2)), np.empty(0), np.empty(0))


@dataclass(frozen=True, slots=True)
class RoadLine:
    """A line beside the path: metres left of it, its kind and style, and how often it is seen."""

    left_m: float
    kind: LandmarkKind
    style: LineStyle
    detected_share: float


TWO_LANES = (
    RoadLine(-1.75, LandmarkKind.LANE_MARKING, LineStyle.SOLID, 0.6),
    RoadLine(1.75, LandmarkKind.LANE_MARKING, LineStyle.DASHED, 0.6),
    RoadLine(5.25, LandmarkKind.LANE_MARKING, LineStyle.SOLID, 0.4),
    RoadLine(-2.6, LandmarkKind.KERB, LineStyle.UNKNOWN, 0.4),
    RoadLine(6.1, LandmarkKind.KERB, LineStyle.UNKNOWN, 0.2),
)
"""A street of two lanes, driven on the right one, with edge lines and kerbs."""


@dataclass(frozen=True, slots=True)
class Repaint:
    """Markings that were painted anew after the map was made, between two ways along the path."""

    from_m: float
    to_m: float
    left_m: float = 0.0
    doubled: bool = False
    missing: bool = False


@dataclass(frozen=True, slots=True)
class LineErrors:
    """What is drawn.

    Attributes:
        map_sd_m, map_length_m: of a mapped line across, and the way over which it wanders.
        common_m, common_s: of all pieces of a frame, and how long it lasts.
        own_m, own_length_m: of one line's pieces, and how long it lasts.
        direction_rad: of a piece; half of it is common.
        clutter: pieces a frame that are of no line.
    """

    map_sd_m: float = 0.05
    map_length_m: float = 60.0
    common_m: float = 0.05
    common_s: float = 5.0
    own_m: float = 0.05
    own_length_m: float = 10.0
    direction_rad: float = 0.01
    clutter: float = 0.3


@dataclass(frozen=True, slots=True)
class Street:
    """What stands and lies beside the path.

    Attributes:
        no_poles_m: from and to, ways along the path without a pole.
        lines: none where empty.
        corner_spacing_m: mean way from one corner to the next; None for none.
        repaint: of the markings.
        corners_moved_m: houses stand so far left of where the map has them, on all of the street.
        corners_elsewhere: the map's corners are those of another street.
    """

    no_poles_m: tuple[float, float] = (np.inf, np.inf)
    lines: tuple[RoadLine, ...] = TWO_LANES
    corner_spacing_m: float | None = None
    repaint: Repaint | None = None
    corners_moved_m: float = 0.0
    corners_elsewhere: bool = False
    errors: LineErrors = field(default_factory=LineErrors)


def ways(states: Floats) -> Floats:
    """Way `(n,)` along a path of poses."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(states[:, :2], axis=0).T))])


def street_drive(scenario: PointScenario, street: Street, seed: int) -> PointDrive:
    """A drive of points along a street; the same seed, the same drive and the same poles."""
    made = simulate_points(scenario, np.random.default_rng(seed))
    rng = np.random.default_rng(seed + 500)
    states = made.motion.states[::20]
    way = ways(states)
    nearest = np.hypot(*(made.poles.points_m[:, None] - states[None, ::5, :2]).transpose(2, 0, 1))
    at = way[::5][nearest.argmin(axis=1)]
    stay = (at < street.no_poles_m[0]) | (at > street.no_poles_m[1])
    poles, pole_map = made.poles.rows(stay), made.pole_map.rows(stay)
    drive = sensed(scenario, made.motion, poles, np.random.default_rng(seed + 700))
    scans = drive.scans
    if street.corner_spacing_m is not None:
        scans, corners = _with_corners(scenario, street, made, scans, states, rng)
        pole_map = join_maps(pole_map, corners)
    if street.lines:
        roads = [_beside(states, way, line.left_m, rng) for line in street.lines]
        mapped = _mapped(scenario, street, roads, rng)
        seen = _Seen(street, roads, rng)
        scans = tuple(
            replace(scan, lines=seen.frame(scan.stamp_s, made.motion.at(scan.stamp_s)[0]))
            for scan in scans
        )
        pole_map = replace(pole_map, lines=mapped)
    return replace(made, drive=replace(drive, scans=scans), poles=poles, pole_map=pole_map)


def _beside(states: Floats, way: Floats, left_m: float, rng: np.random.Generator) -> Floats:
    """Vertices `(v, 3)` of a line beside the path, with their way along it."""
    # the car does not keep to the middle of its lane
    drift = 0.15 * np.sin(2.0 * np.pi * (way / 90.0 + rng.random()))
    across = states[:, 2] + np.pi / 2
    points = states[:, :2] + (left_m + drift)[:, None] * np.stack(
        [np.cos(across), np.sin(across)], axis=1
    )
    rows = np.searchsorted(way, np.arange(0.0, way[-1], _STEP_M))
    # on the inner side of a bend a path that stands still or turns sharply would fold
    return np.column_stack([points[rows], way[rows]])


def _wander(count: int, length_m: float, step_m: float, rng: np.random.Generator) -> Floats:
    """Unit Gauss-Markov noise along a way."""
    keep = np.exp(-step_m / length_m)
    out = np.empty(count)
    out[0] = rng.standard_normal()
    for i in range(1, count):
        out[i] = keep * out[i - 1] + np.sqrt(1.0 - keep**2) * rng.standard_normal()
    return out


def _normals(points: Floats) -> Floats:
    way = np.gradient(points, axis=0)
    way /= np.hypot(*way.T)[:, None]
    return np.stack([-way[:, 1], way[:, 0]], axis=1)


def _mapped(
    scenario: PointScenario, street: Street, roads: list[Floats], rng: np.random.Generator
) -> LineMap:
    errors = street.errors
    vertices = [
        road[:, :2]
        + errors.map_sd_m
        * _wander(len(road), errors.map_length_m, _STEP_M, rng)[:, None]
        * _normals(road[:, :2])
        for road in roads
    ]
    n = len(roads)
    return LineMap(
        frame=scenario.frame,
        vertices_m=np.concatenate(vertices),
        vertex_sd_m=np.full(sum(map(len, vertices)), errors.map_sd_m),
        ids=np.arange(n),
        kind=np.array([line.kind for line in street.lines], dtype=np.int8),
        style=np.array([line.style for line in street.lines], dtype=np.int8),
        count=np.array([len(one) for one in vertices]),
        observations=np.full(n, 20),
        drives=np.ones(n, dtype=np.int64),
        existence=np.ones(n),
    )


class _Seen:
    """What a detector of stated errors sees of the lines, frame by frame."""

    def __init__(self, street: Street, roads: list[Floats], rng: np.random.Generator) -> None:
        self._street, self._rng, self._roads = street, rng, roads
        errors = street.errors
        self._own = [_wander(len(r), errors.own_length_m, _STEP_M, rng) for r in roads]
        self._common = rng.standard_normal(2)
        self._last_s = 0.0

    def frame(self, stamp_s: float, pose: Floats) -> LineDetections:
        errors, rng = self._street.errors, self._rng
        keep = np.exp(-max(stamp_s - self._last_s, 0.0) / errors.common_s)
        self._common = keep * self._common + np.sqrt(1.0 - keep**2) * rng.standard_normal(2)
        self._last_s = stamp_s
        rows: list[tuple[LandmarkKind, LineStyle, Floats]] = []
        for line, road, own in zip(self._street.lines, self._roads, self._own, strict=True):
            for by_m in self._painted(line, road, pose):
                piece = self._piece(road, own, pose, by_m)
                if piece is not None and rng.random() < line.detected_share:
                    rows.append((line.kind, line.style, piece))
        for _ in range(rng.poisson(errors.clutter)):
            middle = np.array([rng.uniform(5.0, 15.0), rng.uniform(-5.0, 6.0)])
            turn = rng.uniform(-0.2, 0.2)
            half = 2.0 * np.array([np.cos(turn), np.sin(turn)])
            kind = rng.choice([LandmarkKind.LANE_MARKING, LandmarkKind.KERB])
            rows.append((kind, LineStyle.UNKNOWN, np.stack([middle - half, middle + half])))
        if not rows:
            return LineDetections.none()
        ends = np.array([piece for _, _, piece in rows])
        n = len(rows)
        style = [s if rng.random() < 0.7 else LineStyle.UNKNOWN for _, s, _ in rows]
        return LineDetections(
            kind=np.array([kind for kind, _, _ in rows], dtype=np.int8),
            style=np.array(style, dtype=np.int8),
            start_vehicle_m=ends[:, 0],
            end_vehicle_m=ends[:, 1],
            offset_sd_m=np.full(n, np.hypot(errors.common_m, errors.own_m)),
            direction_sd_rad=np.full(n, errors.direction_rad),
            probability=np.full(n, 0.9),
        )

    def _painted(self, line: RoadLine, road: Floats, pose: Floats) -> list[float]:
        """How far left of the old line there is one today."""
        paint = self._street.repaint
        if paint is None or line.kind != LandmarkKind.LANE_MARKING:
            return [0.0]
        way = road[np.hypot(*(road[:, :2] - pose[:2]).T).argmin(), 2] + 10.0
        if not paint.from_m <= way <= paint.to_m:
            return [0.0]
        if paint.missing:
            return []
        return [0.0, paint.left_m] if paint.doubled else [paint.left_m]

    def _piece(self, road: Floats, own: Floats, pose: Floats, by_m: float) -> Floats | None:
        """Ends `(2, 2)` of a straight piece fitted to what is seen of a line."""
        errors, rng = self._street.errors, self._rng
        local = inverse_transform_points(pose, road[:, :2])
        first = rng.uniform(5.0, 10.0)
        rows = np.flatnonzero(
            (local[:, 0] > first) & (local[:, 0] < first + 9.0) & (np.abs(local[:, 1]) < 10.0)
        )
        if len(rows) < 3:
            return None
        slope, offset = np.polyfit(local[rows, 0], local[rows, 1], 1)
        x = local[rows[[0, -1]], 0]
        across = by_m + errors.common_m * self._common[0] + errors.own_m * own[rows].mean()
        turn = np.sqrt(0.5) * errors.direction_rad * (self._common[1] + rng.standard_normal())
        y = offset + slope * x + across + turn * (x - x.mean())
        return np.stack([x, y], axis=1)


def _with_corners(
    scenario: PointScenario, street: Street, made: PointDrive, scans: tuple[Detections, ...],
    states: Floats, rng: np.random.Generator,
) -> tuple[tuple[Detections, ...], PoleMap]:  # fmt: skip
    """Scans and a map with corners of houses on both sides of the path."""
    assert street.corner_spacing_m is not None
    way = ways(states)
    station = np.cumsum(rng.gamma(3.0, street.corner_spacing_m / 3.0, int(way[-1] / 4) + 10))
    row = np.searchsorted(way, station[station < way[-1]])
    side = rng.choice([-1.0, 1.0], len(row))
    across = states[row, 2] + np.pi / 2
    left = side * rng.uniform(6.0, 12.0, len(row))
    points = states[row, :2] + left[:, None] * np.stack([np.cos(across), np.sin(across)], axis=1)
    # a corner looks along the street, one way or the other, and a little into it
    facing = states[row, 2] + rng.choice([0.0, np.pi], len(row)) - 0.2 * side
    clear = np.hypot(*(points[:, None] - states[None, ::5, :2]).transpose(2, 0, 1)).min(1) > 4.0
    points, facing = points[clear], wrap_angle(facing[clear])
    n = len(points)
    seen_by = DetectorConfig(detected_share=0.5, clutter_share=0.2)
    detector = PoleDetector(points, np.full(n, 0.2), seen_by, rng)
    turned = 0.1 * rng.standard_normal(n)
    joined = []
    for scan in scans:
        pose = made.motion.at(scan.stamp_s)[0]
        found = detector.scan(scan.stamp_s, pose)
        local = inverse_transform_points(pose, points)
        distance = np.hypot(*(found.points_vehicle_m[:, None] - local).transpose(2, 0, 1))
        of = distance.argmin(axis=1) if n else np.empty(0, dtype=np.int64)
        real = distance.min(axis=1) < 1.5 if n else np.empty(0, dtype=np.bool_)
        noise = turned[of] + 0.1 * rng.standard_normal(len(found))
        looks = np.where(real, facing[of] - pose[2] + noise, rng.uniform(-np.pi, np.pi, len(found)))
        corners = found.with_columns(
            kind=np.full(len(found), LandmarkKind.CORNER, dtype=np.int8),
            width_m=np.full(len(found), np.nan),
            facing_rad=np.asarray(wrap_angle(looks)),
        )
        both = {
            name: np.concatenate([values, corners.arrays()[name]])
            for name, values in scan.arrays().items()
        }
        joined.append(
            Detections.from_arrays(
                both, stamp_s=scan.stamp_s, arrival_s=scan.arrival_s, view=scan.view
            )
        )
    points = _mapped_corners(street, points, states, rng)
    plain = Poles(points, np.full(n, np.nan), np.ones(n)).surveyed(
        scenario.frame, scenario.map_sd_m, rng
    )
    extra = {
        KIND_COLUMN: np.full(n, LandmarkKind.CORNER, dtype=np.int8),
        "facing_rad": np.asarray(facing),
    }
    return tuple(joined), replace(plain, ids=plain.ids + 100_000, extra=extra)


def _mapped_corners(
    street: Street, points: Floats, states: Floats, rng: np.random.Generator
) -> Floats:
    """Where the map has corners `(n, 2)`."""
    if not len(points):
        return points
    if street.corners_elsewhere:
        row = rng.integers(0, len(states), len(points))
        left = rng.choice([-1.0, 1.0], len(points)) * rng.uniform(6.0, 12.0, len(points))
        return states[row, :2] + left[:, None] * _left(states[row, 2])
    nearest = np.hypot(*(points[:, None] - states[None, ::5, :2]).transpose(2, 0, 1)).argmin(1)
    return points - street.corners_moved_m * _left(states[::5][nearest, 2])


def _left(yaw_rad: Floats) -> Floats:
    return np.stack([-np.sin(yaw_rad), np.cos(yaw_rad)], axis=1)
