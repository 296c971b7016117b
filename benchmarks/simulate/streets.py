"""Simulated streets that are looked at frame by frame, without a drive on disk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from polemap.drivelog.streams import OdometryStream
from polemap.simulate import sensors
from polemap.simulate.config import RenderConfig, SimulateConfig
from polemap.simulate.scenario import load_scenario
from polemap.simulate.studio import Plan, Studio, make_plan
from polemap.simulate.world import World, make_world


@dataclass(frozen=True, slots=True)
class Street:
    """A world, a lap through it, the odometry of that lap, and who takes its pictures."""

    world: World
    plan: Plan
    odometry: OdometryStream
    studio: Studio


def open_street(
    name: str,
    seed: int,
    rate_hz: float,
    *,
    truth_images: bool = False,
    camera: Mapping[str, float] | None = None,
) -> Street:
    """The street that `polemap simulate NAME --seed SEED` would write, at another frame rate.

    Args:
        camera: settings of another camera.
    """
    plain = SimulateConfig()
    config = plain.model_copy(
        update={
            "camera": plain.camera.model_copy(update={"frame_rate_hz": rate_hz, **(camera or {})}),
            "render": RenderConfig(truth_images=truth_images),
        }
    )
    world = make_world(load_scenario(name), seed)
    plan = make_plan(world.route, world.scenario, 1, seed, config)
    odometry = sensors.odometry(plan.motion, config.odometry, np.random.default_rng([seed, 22]))
    return Street(world, plan, odometry, Studio(plan, world, 1))
