"""The road plane there and back, drawn lanes with known truth, and real highway pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.stereo.lane import LaneFinder
from polemap.stereo.road_plane import BirdsEye, RoadCamera, RoadGrid
from polemap.vehicle.errors import VehicleError

CAMERA = RoadCamera.from_focal(640, 480, 600.0, 1.3, 0.08)


@given(x=st.floats(3.0, 80.0), y=st.floats(-10.0, 10.0))
def test_mapping_there_and_back(x: float, y: float) -> None:
    pixel = CAMERA.road_to_pixel([x, y])
    assert CAMERA.pixel_to_road(pixel) == pytest.approx([x, y], abs=1e-6)


def test_mapping_is_the_pinholes() -> None:
    """Against a rotation and a division, no tangents."""
    c, s, f = np.cos(0.08), np.sin(0.08), 600.0
    x, y, h = 12.0, 1.5, 1.3
    depth, down, left = x * c + h * s, -x * s + h * c, y
    row, column = 239.5 + f * down / depth, 319.5 - f * left / depth
    assert CAMERA.road_to_pixel([x, y]) == pytest.approx([row, column], abs=1e-9)


def test_above_the_horizon_there_is_no_road() -> None:
    assert np.isnan(CAMERA.pixel_to_road([0.0, 320.0])[0])


def drawn(offset_m: float, slope: float, bend: float, seed: int = 0) -> np.ndarray:
    """A noisy road with a solid left line `y = offset + slope x + bend x^2`, 0.15 m wide."""
    rows, columns = np.indices((480, 640))
    road = CAMERA.pixel_to_road(np.stack([rows, columns], axis=-1))
    x, y = road[..., 0], road[..., 1]
    line = np.abs(y - offset_m - slope * x - bend * x * x) < 0.075
    image = np.where(line & (x < 60.0), 190.0, 90.0)
    image += 4.0 * np.random.default_rng(seed).standard_normal(image.shape)
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("offset", "slope", "bend"), [(1.7, 0.0, 0.0), (1.4, 0.03, 0.0), (1.8, -0.02, 0.002)]
)
def test_drawn_line_is_measured_within_its_deviation(
    offset: float, slope: float, bend: float
) -> None:
    finder = LaneFinder(CAMERA, rng=np.random.default_rng(0), preview_m=8.0)
    seen = finder.find(drawn(offset, slope, bend), 2.0, 2.03)
    assert seen is not None
    tangent = slope + 2.0 * bend * 8.0
    true = np.array(
        [-np.arctan(tangent), -(offset + 8 * slope + 64 * bend) / np.hypot(1.0, tangent)]
    )
    error = np.array([seen.heading_rad, seen.lateral_offset_m]) - true
    assert np.abs(error) == pytest.approx(0.0, abs=0.03)
    assert error @ np.linalg.solve(seen.covariance, error) < 20.0
    assert (seen.stamp_s, seen.arrival_s, seen.side) == (2.0, 2.03, "left")


def test_a_jumping_line_is_gated_and_then_searched_afresh() -> None:
    finder = LaneFinder(CAMERA, rng=np.random.default_rng(0), preview_m=8.0)
    assert finder.find(drawn(1.6, 0.0, 0.0), 0.0, 0.0) is not None
    answers = [finder.find(drawn(2.6, 0.0, 0.0, k), 0.1 * k, 0.1 * k) for k in range(1, 8)]
    assert answers[0] is None
    assert answers[-1] is not None
    assert answers[-1].lateral_offset_m == pytest.approx(-2.6, abs=0.05)


def test_an_empty_road_gives_nothing() -> None:
    noise = np.random.default_rng(1).integers(80, 100, (480, 640)).astype(np.uint8)
    assert LaneFinder(CAMERA, rng=np.random.default_rng(0)).find(noise, 0.0, 0.0) is None


def test_wrong_images_and_cameras_are_refused() -> None:
    with pytest.raises(VehicleError, match="a grey one"):
        BirdsEye(CAMERA, RoadGrid()).warp(np.zeros((10, 10), np.uint8))
    with pytest.raises(VehicleError, match="road camera"):
        RoadCamera(640, 480, 0.5, 0.4, -1.0, 0.1)
    with pytest.raises(VehicleError, match="angles"):
        RoadCamera(640, 480, 2.0, 0.4, 1.0, 0.1)


def test_highway_pictures_show_both_markings(recording: Callable[[str], Path]) -> None:
    for path in sorted(recording("lanes").glob("*.jpg")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        height, width = image.shape
        focal = width * 0.9
        pitch = -float(np.arctan((0.09 * height) / focal))
        camera = RoadCamera.from_focal(width, height, focal, 1.3, pitch)
        seen = LaneFinder(camera, rng=np.random.default_rng(0), preview_m=10.0).find(
            image, 0.0, 0.0
        )
        assert seen is not None, path.name
        assert abs(seen.heading_rad) < 0.04, path.name
        assert 1.2 < abs(seen.lateral_offset_m) < 2.9, path.name
