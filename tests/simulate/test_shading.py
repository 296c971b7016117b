"""The shading kernel against the same in arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import polemap.simulate.render as render
from polemap.simulate.camera_mounting import camera_poses
from polemap.simulate.materials import TILES
from polemap.simulate.mesh import box
from polemap.simulate.render import Renderer, RenderOptions, View
from polemap.simulate.scenario import LightSpec
from polemap.simulate.shading import make_shader
from polemap.simulate.world import World
from polemap.stereo.rig import Mounting, StereoRig, rotation_from_angles

RIG = StereoRig(200, 120, 160.0, 99.5, 59.5, 0.4, Mounting(1.5, 0.2, 1.4))


def views(
    world: World, backend: str, options: RenderOptions, monkeypatch: pytest.MonkeyPatch
) -> tuple[View, View]:
    monkeypatch.setattr(
        render,
        "make_shader",
        lambda *args: make_shader(*args, backend=backend),  # type: ignore[arg-type]
    )
    x, y, yaw = world.route.at(np.array(30.0), -1.65)
    turn = rotation_from_angles(float(yaw), 0.02, 0.01)
    poses = camera_poses(RIG, np.array([x, y, 0.0]), turn)
    ahead = np.array([x, y]) + 9 * np.array([np.cos(yaw), np.sin(yaw)])
    car = box((0, 0, 0.8), (2.0, 1.6, 1.6), TILES["enamel"]).placed(*ahead, 0.0, float(yaw))
    return Renderer(world, RIG, options).pair(poses, car.owned_by(60_001))


@pytest.mark.parametrize("dusk", [False, True])
@pytest.mark.parametrize("shadows", ["none", "map", "rays"])
def test_the_kernel_equals_arrays(
    world: World, dusk: bool, shadows: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("polemap.simulate.native.shading_kernel", reason="the kernel is not built")
    if dusk:
        light = LightSpec(sun_elevation_deg=8, sun=0.3, sky=0.05, clouds=0.5, dusk=True)
        scenario = world.scenario.model_copy(update={"light": light})
        world = replace(world, scenario=scenario)
    options = RenderOptions(1, shadows != "none", shadows == "rays")
    pairs = [views(world, backend, options, monkeypatch) for backend in ("native", "numpy")]
    for fast, plain in zip(*pairs, strict=True):
        assert np.array_equal(fast.owner, plain.owner)
        assert np.array_equal(fast.depth_m, plain.depth_m)
        assert (fast.owner == 60_001).sum() > 200
        off = np.abs(fast.irradiance - plain.irradiance)
        assert off.mean() < 2e-4 * plain.irradiance.mean()
        # a shadow's border and a mipmap level may fall to the other side by rounding
        assert (off > 0.01 * plain.irradiance).mean() < 5e-4
