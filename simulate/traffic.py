"""What moves: oncoming cars, cars ahead, cyclists, pedestrians; others in every lap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polemap.simulate.driver import Motion
from polemap.simulate.ground import kerb_m
from polemap.simulate.mesh import Mesh, join
from polemap.simulate.objects import person
from polemap.simulate.vehicles import car, cyclist
from polemap.simulate.world import World

MOVER_ID = 100_000
_LANE_M, _GAP_M = 1.7, 9.0


@dataclass(frozen=True, slots=True)
class Mover:
    """Something that keeps its lateral place and speed along the route for a while.

    `station_m` at `from_s`; `speed_mps` negative against the car's direction. `stride_s` is the
    period of a walker's step, 0 for wheels; two meshes then alternate.
    """

    meshes: tuple[Mesh, ...]
    from_s: float
    until_s: float
    station_m: float
    speed_mps: float
    lateral_m: float
    stride_s: float = 0.0

    def placed(self, world: World, stamp_s: float) -> Mesh | None:
        """The mesh in the world at a time, None while it is not there."""
        if not self.from_s <= stamp_s < self.until_s:
            return None
        station = self.station_m + self.speed_mps * (stamp_s - self.from_s)
        if not world.route.closed and not 0 <= station <= world.route.length_m:
            return None
        x, y, yaw = (float(v) for v in world.route.at(np.array(station), self.lateral_m))
        turn = yaw if self.speed_mps >= 0 else yaw + np.pi
        step = 0
        if self.stride_s > 0:
            step = int(stamp_s / self.stride_s) % len(self.meshes)
        height = float(world.section.height_at(self.lateral_m))
        return self.meshes[step].placed(x, y, height, turn)


def _lanes(world: World) -> list[float]:
    """Lateral middles of the lanes in the car's direction."""
    section, own = world.scenario.section, world.scenario.drive.lane_offset_m
    inner = section.median_width_m / 2
    count = max(1, int((section.road_half_width_m - inner) / section.lane_width_m + 0.05))
    if count == 1:
        return [own]
    sign = 1.0 if own > 0 else -1.0
    return [sign * (inner + (k + 0.5) * section.lane_width_m) for k in range(count)]


def make_traffic(world: World, motion: Motion, rng: np.random.Generator) -> list[Mover]:
    """Movers that the car meets: each is planned by where and when they meet.

    Whatever would drive through another mover, or through the car, is left out.
    """
    spec = world.scenario.traffic
    way_km = (motion.station_m[-1] - motion.station_m[0]) / 1000
    plans = (
        ("oncoming", spec.oncoming_per_km),
        ("ahead", spec.ahead_per_km),
        ("beside", spec.beside_per_km),
        ("cyclist", spec.cyclists_per_km),
        ("walker", spec.pedestrians_per_km),
    )
    movers: list[Mover] = []
    for kind, per_km in plans:
        for _ in range(int(rng.poisson(per_km * way_km))):
            meet_s = float(rng.uniform(2.0, motion.stamp_s[-1]))
            mover = _plan(kind, meet_s, world, motion, MOVER_ID + len(movers), rng)
            clear = not any(_collide(mover, other) for other in movers)
            if kind == "walker" or (clear and not _hits_car(mover, motion)):
                movers.append(mover)
    return movers


def _plan(
    kind: str, meet_s: float, world: World, motion: Motion, ident: int, rng: np.random.Generator
) -> Mover:
    section, own, lanes = world.scenario.section, world.scenario.drive.lane_offset_m, _lanes(world)
    meet_m = float(motion.value("station_m", np.array([meet_s]))[0])
    pace = float(motion.value("speed_mps", np.array([meet_s]))[0])
    side = 1.0 if rng.uniform() < 0.5 else -1.0
    before, after, stride = 9.0, 9.0, 0.0
    meshes: tuple[Mesh, ...]
    if kind == "cyclist":
        meshes, before, after = (cyclist(rng).owned_by(ident),), 14.0, 5.0
        lateral = side * (section.road_half_width_m - 0.7)
        # on the right-hand side with the traffic, on the left against the car
        speed = float(rng.uniform(3.5, 6)) * (1.0 if lateral * own > 0 else -1.0)
    elif kind == "walker":
        meshes, before, after, stride = _steps(rng, ident), 30.0, 6.0, 0.25
        middle = kerb_m(section) + 0.3 + section.verge_width_m + 0.5 * section.sidewalk_width_m
        lateral = side * (middle + float(rng.normal(0, 0.3)))
        speed = (1.0 if rng.uniform() < 0.5 else -1.0) * float(rng.uniform(0.9, 1.6))
    else:
        meshes = (car(rng).owned_by(ident),)
        if kind == "oncoming":
            before, after = 12.0, 4.0
            speed, lateral = -float(rng.uniform(6, 11)), -float(rng.choice(lanes))
        elif kind == "ahead":
            before = 0.0
            speed, lateral = max(pace, 3.0) * float(rng.uniform(1.0, 1.3)) + 0.5, own
            meet_m += float(rng.uniform(14, 30))
        else:
            others = [x for x in lanes if abs(x - own) > 1.5] or [own * 3]
            mean = float(np.mean(motion.speed_mps))
            speed, lateral = mean * float(rng.uniform(0.6, 1.4)), float(rng.choice(others))
            meet_m += float(rng.uniform(-5, 25))
    start = meet_m - speed * before
    return Mover(meshes, meet_s - before, meet_s + after, start, speed, lateral, stride)


def _steps(rng: np.random.Generator, ident: int) -> tuple[Mesh, ...]:
    """One person in three phases of a step."""
    form = rng.bit_generator.state
    phases = []
    for stretch in (0.55, 0.05, 0.45):
        rng.bit_generator.state = form
        phases.append(person(rng, stretch).owned_by(ident))
    return tuple(phases)


def _collide(one: Mover, other: Mover) -> bool:
    """Whether two movers of one lane come within a car's length and a bit while both are there."""
    low, high = max(one.from_s, other.from_s), min(one.until_s, other.until_s)
    if low >= high or abs(one.lateral_m - other.lateral_m) > _LANE_M:
        return False
    gaps = [
        one.station_m + one.speed_mps * (t - one.from_s)
        - other.station_m - other.speed_mps * (t - other.from_s)
        for t in (low, high)
    ]  # fmt: skip
    return gaps[0] * gaps[1] < 0 or min(abs(gaps[0]), abs(gaps[1])) < _GAP_M


def _hits_car(mover: Mover, motion: Motion) -> bool:
    """Whether the mover gets into the way of the car itself."""
    times = np.arange(max(mover.from_s, 0.0), min(mover.until_s, float(motion.stamp_s[-1])), 0.2)
    along = mover.station_m + mover.speed_mps * (times - mover.from_s)
    beside = np.abs(motion.value("lateral_m", times) - mover.lateral_m)
    near = np.abs(along - motion.value("station_m", times)) < _GAP_M
    return bool(np.any(near & (beside < _LANE_M)))


def moving_mesh(movers: list[Mover], world: World, stamp_s: float) -> Mesh:
    """All moving things at a time as one mesh."""
    here = (mover.placed(world, stamp_s) for mover in movers)
    return join([mesh for mesh in here if mesh is not None])
