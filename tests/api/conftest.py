"""A loop of lamps and posts, filmed for two laps with a small camera."""

from __future__ import annotations

from pathlib import Path

import pytest

from polemap.simulate.camera_mounting import CameraConfig
from polemap.simulate.config import RenderConfig, SimulateConfig
from polemap.simulate.drive import simulate_drive
from polemap.simulate.scenario import Scenario


@pytest.fixture(scope="session")
def loop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the folder `drive` in it, whose laps are lap_1 and lap_2."""
    scenario = Scenario.model_validate(
        {
            "name": "loop",
            "route": {
                "closed": True,
                "corner_radius_m": 8.0,
                "corners_m": [[0, 0], [36, 0], [36, 20], [0, 20]],
            },
            "rows": [
                {"kind": "lamp", "side": "right", "spacing_m": 16, "offset_m": 0.5},
                {"kind": "thin_post", "side": "right", "spacing_m": 13, "offset_m": 1.0},
                {"kind": "lamp", "side": "left", "spacing_m": 14, "offset_m": 0.7},
            ],
            "drive": {"speed_mps": 8.0, "standstill_s": 1.0},
            "backdrop": False,
        }
    )
    camera = CameraConfig(width_px=400, height_px=240, focal_px=380.0, frame_rate_hz=4.0)
    config = SimulateConfig(camera=camera, render=RenderConfig(workers=1, shadows=False))
    place = tmp_path_factory.mktemp("loop")
    simulate_drive(scenario, place / "drive", 2, 3, config)
    return place
