"""A small street for the simulator's tests: everything of a world, quickly made."""

from __future__ import annotations

import pytest

from polemap.simulate.camera_mounting import CameraConfig
from polemap.simulate.config import RenderConfig, SimulateConfig
from polemap.simulate.scenario import Scenario
from polemap.simulate.world import World, make_world


@pytest.fixture(scope="session")
def street() -> Scenario:
    """A closed loop of about 105 m with a few lamps, posts and trees, without houses."""
    return Scenario.model_validate(
        {
            "name": "street",
            "route": {
                "closed": True,
                "corner_radius_m": 8.0,
                "corners_m": [[0, 0], [40, 0], [40, 20], [0, 20]],
            },
            "rows": [
                {"kind": "lamp", "side": "right", "spacing_m": 20, "offset_m": 0.5},
                {"kind": "thin_post", "side": "right", "spacing_m": 17, "offset_m": 1.0},
                {"kind": "bush", "side": "right", "spacing_m": 15, "offset_m": 4.0},
            ],
            "traffic": {"oncoming_per_km": 20},
            "drive": {"speed_mps": 8.0, "standstill_s": 1.0},
            "backdrop": False,
        }
    )


@pytest.fixture(scope="session")
def world(street: Scenario) -> World:
    return make_world(street, 5)


@pytest.fixture(scope="session")
def small() -> SimulateConfig:
    """A tiny camera, so that a drive takes a second."""
    return SimulateConfig(
        camera=CameraConfig(width_px=96, height_px=64, focal_px=103.0, frame_rate_hz=1.0),
        render=RenderConfig(workers=1, shadows=False),
    )
