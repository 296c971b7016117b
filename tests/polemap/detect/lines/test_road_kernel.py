"""The C++ kernel of the road grid against the plain way, on roads made here."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.detect.ground import fit_ground
from polemap.detect.lines import kerbs, markings, road_frame
from polemap.detect.lines.find import find_lines
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.extras import kernel
from polemap.stereo.depth_edges import UprightMaps
from tests.polemap.detect.lines.scenes import RIG, Scene

Floats = NDArray[np.float64]


def _paint(x: Floats, y: Floats) -> Floats:
    return np.where((np.abs(y - 0.02 * x) < 0.07) | ((x % 5.0 < 2.0) & (y < -2.0)), 150.0, 90.0)


def _scene(seed: int) -> tuple[NDArray[np.uint8], UprightMaps]:
    scene = Scene(kerb_m=2.4, step_m=0.14, wall_m=4.5, light=_paint, seed=seed, noise_px=0.4)
    image, maps = scene.take()
    holes = np.random.default_rng(seed).uniform(size=maps.left.shape) < 0.2
    left = np.where(holes, np.float32(0.0), maps.left)
    return image, UprightMaps(left, left, maps.row_step_px, maps.height_px)


NATIVE = kernel("polemap.detect.native.road_kernel")


@pytest.mark.skipif(NATIVE is None, reason="the kernel is not built")
@pytest.mark.parametrize("seed", range(2))
def test_the_kernel_says_what_the_plain_way_says(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    image, maps = _scene(seed)
    ground = fit_ground(maps, RIG)
    found = []
    for native in (kernel, lambda name: None):
        for module in (road_frame, kerbs, markings):
            monkeypatch.setattr(module, "kernel", native)
        view = road_frame.view_road(image, maps, ground, RIG)
        found.append((view, kerbs.kerb_points(view, maps), markings.marking_points(view)))
    assert len(found[0][1].row) > 5
    assert len(found[0][2].row) > 20
    for one, two in zip(*found, strict=True):
        for name in one.__slots__:
            if name != "frame":
                np.testing.assert_allclose(
                    getattr(one, name), getattr(two, name), rtol=1e-6, atol=1e-6, err_msg=name
                )


def test_without_a_compiler_the_plain_way_serves_and_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def none(name: str) -> None:
        raise ImportError(name)

    image, maps = _scene(0)
    with monkeypatch.context() as patched:
        patched.setattr("polemap.extras.import_module", none)
        kernel.cache_clear()
        with pytest.warns(RuntimeWarning, match="road_kernel is not built"):
            plain = find_lines(
                image, maps, fit_ground(maps, RIG), RIG, frozenset({LandmarkKind.KERB})
            )
    kernel.cache_clear()
    assert plain is not None
    assert len(plain)
