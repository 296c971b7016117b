"""A world on one screen: route, ground, houses, furniture, light, from a scenario and a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import ConfigError
from polemap.simulate.buildings import backdrop, house
from polemap.simulate.ground import kerb_m, make_ground, make_section, side_street
from polemap.simulate.mesh import Mesh, join
from polemap.simulate.objects import MAKERS, Corner, Maker, Wish
from polemap.simulate.route import CrossSection, Route, make_route
from polemap.simulate.scenario import HousesSpec, RowSpec, Scenario
from polemap.simulate.skyline import Fronts
from polemap.simulate.vegetation import PLANTS
from polemap.simulate.vehicles import PARKED
from polemap.simulate.walls import WALLS
from polemap.vehicle.pose import transform_points, wrap_angle

Floats = NDArray[np.float64]
KINDS: dict[str, Maker] = {**MAKERS, **PLANTS, **PARKED, **WALLS}


@dataclass(frozen=True, slots=True)
class WorldObject:
    """A standing object of the truth.

    `x_m, y_m` is the axis at ground level in the world's local metres; `owner` the id in the
    rendered object-id pictures.
    """

    owner: int
    kind: str
    pole: bool
    x_m: float
    y_m: float
    width_m: float
    height_m: float


@dataclass(frozen=True, slots=True)
class WorldCorner:
    """A vertical edge of a building or a wall, in the world's local metres.

    `owner` is the id of what it belongs to, 0 of a house; `facing_rad` points away from that,
    between the two sides that meet there.
    """

    owner: int
    kind: str
    x_m: float
    y_m: float
    facing_rad: float
    height_m: float


@dataclass(frozen=True, slots=True)
class World:
    """Everything that stands still."""

    scenario: Scenario
    seed: int
    route: Route
    section: CrossSection
    mesh: Mesh
    objects: tuple[WorldObject, ...]
    fronts: Fronts
    corners: tuple[WorldCorner, ...]

    def poles(self) -> tuple[WorldObject, ...]:
        """The objects that belong into a pole map."""
        return tuple(o for o in self.objects if o.pole)


def make_world(scenario: Scenario, seed: int, removed: frozenset[int] = frozenset()) -> World:
    """Builds the world; `removed` leaves out objects by their id without moving any other.

    Raises:
        ConfigError: a row names a kind that does not exist, or the route cannot be drawn.
    """
    route = make_route(
        scenario.route.corners_m, scenario.route.corner_radius_m, scenario.route.closed
    )
    section = make_section(scenario.section)
    parts = [make_ground(route, section, scenario.section, np.random.default_rng([seed, 1]))]
    parts += [side_street(route, section, scenario.section, s) for s in scenario.side_streets]
    objects: list[WorldObject] = []
    blocked: list[tuple[float, float, float]] = []
    corners: list[WorldCorner] = []
    fronts: list[tuple[float, float, float, float, float]] = []
    for index, spec in enumerate(scenario.houses):
        rng = np.random.default_rng([seed, 2, index])
        meshes, places, edges = _houses(spec, scenario, route, section, rng)
        parts, fronts, corners = parts + meshes, fronts + places, corners + edges
    for index, row in enumerate(scenario.rows):
        maker = KINDS.get(row.kind)
        if maker is None:
            raise ConfigError(
                f"scenario {scenario.name}: rows.{index}.kind is {row.kind!r}; "
                f"known kinds: {', '.join(sorted(KINDS))}"
            )
        rng = np.random.default_rng([seed, 3, index])
        for mesh, thing, edges in _row(
            row, maker, scenario, route, section, rng, blocked, len(objects) + 1
        ):
            objects.append(thing)
            if thing.owner not in removed:
                parts.append(mesh)
                corners += edges
    if scenario.backdrop:
        centre = route.points_m.mean(axis=0)
        reach = float(np.hypot(*(route.points_m - centre).T).max()) + 55
        parts.append(
            backdrop(np.random.default_rng([seed, 4]), (float(centre[0]), float(centre[1])), reach)
        )
    standing = tuple(o for o in objects if o.owner not in removed)
    return World(
        scenario, seed, route, section, join(parts), standing, Fronts.of(fronts), tuple(corners)
    )


def _placed(
    corners: tuple[Corner, ...], owner: int, kind: str, x_m: float, y_m: float, turn_rad: float
) -> list[WorldCorner]:
    """Corners of a thing that stands turned at (x, y)."""
    pose = np.array([x_m, y_m, turn_rad])
    places = transform_points(pose, np.array([[c.x_m, c.y_m] for c in corners]).reshape(-1, 2))
    return [
        WorldCorner(owner, kind, x, y, float(wrap_angle(c.facing_rad + turn_rad)), c.height_m)
        for c, (x, y) in zip(corners, places.tolist(), strict=True)
    ]


def _sides(side: str) -> tuple[float, ...]:
    return {"left": (1.0,), "right": (-1.0,), "both": (1.0, -1.0)}[side]


def _in_mouth(scenario: Scenario, station_m: float, side: float, reach_m: float) -> bool:
    """Whether a place lies where a side street joins."""
    return any(
        (s.side == "left") == (side > 0) and abs(station_m - s.at_m) < s.width_m / 2 + reach_m
        for s in scenario.side_streets
    )


def _row(
    row: RowSpec,
    maker: Maker,
    scenario: Scenario,
    route: Route,
    section: CrossSection,
    rng: np.random.Generator,
    blocked: list[tuple[float, float, float]],
    first: int,
) -> list[tuple[Mesh, WorldObject, list[WorldCorner]]]:
    """The objects of one row; places that another object occupies stay empty."""
    end = min(row.to_m or route.length_m, route.length_m)
    made: list[tuple[Mesh, WorldObject, list[WorldCorner]]] = []
    for side in _sides(row.side):
        station = row.from_m + rng.uniform(0.1, 0.9) * row.spacing_m
        if row.irregular == 0.0:
            station = row.from_m + row.spacing_m / 2
        while station < end:
            step = row.spacing_m * (1 + row.irregular * rng.uniform(-0.8, 0.8))
            offset = row.offset_m + rng.normal(0, 1) * row.offset_jitter_m
            lateral = side * (kerb_m(scenario.section) + 0.17 + offset)
            x, y, yaw = (float(v) for v in route.at(np.array(station), lateral))
            wish = Wish(float(np.deg2rad(row.lean_deg)), row.height_m, row.radius_m)
            made_one = maker(rng, wish)
            here, station = station, station + step
            reach = 2.2 if row.kind.startswith("parked_") else 0.45
            long = row.kind in ("fence", "hedge")
            crowded = any(np.hypot(x - a, y - b) < r + reach for a, b, r in blocked)
            mouth = _in_mouth(scenario, here, side, 4.0 if long else reach)
            mouth |= row.offset_m < 0 and scenario.in_u_turn(here)
            if rng.uniform() > row.keep or (crowded and not long) or mouth:
                continue
            if not long:
                blocked.append((x, y, reach))
            owner = first + len(made)
            height = float(section.height_at(lateral))
            turn = yaw if side < 0 else yaw + np.pi
            mesh = made_one.mesh.placed(x, y, height, turn).owned_by(owner)
            thing = WorldObject(
                owner, row.kind, made_one.pole, x, y, made_one.width_m, made_one.height_m
            )
            edges = _placed(made_one.corners, owner, row.kind, x, y, turn)
            made.append((mesh, thing, edges))
    return made


def _houses(
    spec: HousesSpec,
    scenario: Scenario,
    route: Route,
    section: CrossSection,
    rng: np.random.Generator,
) -> tuple[list[Mesh], list[tuple[float, float, float, float, float]], list[WorldCorner]]:
    """Houses with their fronts parallel to the street, and these; none inside a tight bend."""
    parts, fronts, corners = [], [], list[WorldCorner]()
    for side in _sides(spec.side):
        station = float(rng.uniform(0, 6))
        while station < route.length_m - 8:
            width = float(rng.uniform(*spec.width_m))
            middle = np.array(station + width / 2)
            built = house(rng, width, int(rng.integers(spec.storeys[0], spec.storeys[1] + 1)))
            lateral = side * (kerb_m(scenario.section) + 0.17 + spec.setback_m)
            x, y, yaw = (float(v) for v in route.at(middle, lateral))
            stretch = 1.0 - side * abs(lateral) * float(route.curvature_at(middle))
            station += width / max(stretch, 0.3) + float(rng.uniform(*spec.gap_m))
            tight = side * float(route.curvature_at(middle)) > 0.02
            if (
                rng.uniform() > spec.keep
                or tight
                or _in_mouth(scenario, float(middle), side, width / 2)
            ):
                continue
            base = float(section.height_at(lateral)) - 0.1
            turn = yaw if side < 0 else yaw + np.pi
            parts.append(built.mesh.placed(x, y, base, turn))
            corners += _placed(built.corners, 0, "house", x, y, turn)
            fronts.append((x, y, yaw, width, built.height_m))
    return parts, fronts, corners
