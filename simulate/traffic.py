"""What moves: oncoming cars, cars ahead, cyclists, pedestrians; others in every lap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulate.driver import Motion
from simulate.ground import kerb_m
from simulate.mesh import Mesh, join
from simulate.objects import person
from simulate.vehicles import car, cyclist
from simulate.world import World

MOVER_ID = 100_000


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
    """Movers that the car meets: each is planned by where and when they meet."""
    spec, section = world.scenario.traffic, world.scenario.section
    own = world.scenario.drive.lane_offset_m
    way_km = (motion.station_m[-1] - motion.station_m[0]) / 1000
    movers: list[Mover] = []
    lanes = _lanes(world)
    walk = kerb_m(section) + 0.3 + section.verge_width_m + 0.5 * section.sidewalk_width_m
    plans = (
        ("oncoming", spec.oncoming_per_km),
        ("ahead", spec.ahead_per_km),
        ("beside", spec.beside_per_km),
        ("cyclist", spec.cyclists_per_km),
        ("walker", spec.pedestrians_per_km),
    )
    for kind, per_km in plans:
        for _ in range(int(rng.poisson(per_km * way_km))):
            meet_s = float(rng.uniform(2.0, motion.stamp_s[-1]))
            meet_m = float(motion.value("station_m", np.array([meet_s]))[0])
            ident = MOVER_ID + len(movers)
            side = 1.0 if rng.uniform() < 0.5 else -1.0
            if kind == "oncoming":
                speed = -float(rng.uniform(6, 11))
                lateral = float(rng.choice([-x for x in lanes]))
                meshes: tuple[Mesh, ...] = (car(rng).owned_by(ident),)
                before, after, stride = 12.0, 4.0, 0.0
            elif kind == "ahead":
                mean = float(np.mean(motion.speed_mps))
                speed, lateral = mean * float(rng.uniform(0.95, 1.25)) + 1.0, own
                meshes, before, after, stride = (car(rng).owned_by(ident),), 0.0, 9.0, 0.0
                meet_m += float(rng.uniform(14, 30))
            elif kind == "beside":
                mean = float(np.mean(motion.speed_mps))
                others = [x for x in lanes if abs(x - own) > 1.5] or [own * 3]
                speed, lateral = mean * float(rng.uniform(0.6, 1.4)), float(rng.choice(others))
                meshes, before, after, stride = (car(rng).owned_by(ident),), 9.0, 9.0, 0.0
                meet_m += float(rng.uniform(-5, 25))
            elif kind == "cyclist":
                speed = side * -float(rng.uniform(3.5, 6))
                lateral = side * (section.road_half_width_m - 0.7)
                if speed > 0 and lateral * own > 0:
                    speed = -speed
                meshes, before, after, stride = (cyclist(rng).owned_by(ident),), 14.0, 5.0, 0.0
            else:
                speed = (1.0 if rng.uniform() < 0.5 else -1.0) * float(rng.uniform(0.9, 1.6))
                lateral = side * (walk + float(rng.normal(0, 0.3)))
                form = rng.bit_generator.state
                frames = []
                for stretch in (0.55, 0.05, 0.45):
                    rng.bit_generator.state = form
                    frames.append(person(rng, stretch).owned_by(ident))
                meshes, before, after, stride = tuple(frames), 30.0, 6.0, 0.25
            start = meet_s - before
            movers.append(
                Mover(
                    meshes, start, meet_s + after, meet_m - speed * before, speed, lateral, stride
                )
            )
    return movers


def moving_mesh(movers: list[Mover], world: World, stamp_s: float) -> Mesh:
    """All moving things at a time as one mesh."""
    here = (mover.placed(world, stamp_s) for mover in movers)
    return join([mesh for mesh in here if mesh is not None])
