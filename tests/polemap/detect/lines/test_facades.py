"""Facades in disparities that are drawn from walls whose places are known."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.detect.ground import fit_ground
from polemap.detect.lines.find import find_lines
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.line_detections import LineDetections
from polemap.stereo.depth_edges import upright_maps
from polemap.vehicle.pose import wrap_angle
from tests.polemap.detect.test_corners import Wall, matched_maps
from tests.polemap.street import RIG

ALONG = Wall((8.0, -5.0), (22.0, -5.6))
ACROSS = Wall((14.0, 2.0), (15.0, 9.0))


def _facades(walls: list[Wall], seed: int) -> LineDetections:
    maps = upright_maps(matched_maps(walls, seed, noise_px=0.3), 3)
    image = np.zeros((RIG.height_px, RIG.width_px), dtype=np.uint8)
    lines = find_lines(image, maps, fit_ground(maps, RIG), RIG, frozenset({LandmarkKind.FACADE}))
    assert lines is not None
    return lines


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("wall", [ALONG, ACROSS], ids=["along", "across"])
def test_a_wall_is_a_line_where_it_stands(wall: Wall, seed: int) -> None:
    post = Wall((6.0, -2.6), (6.0, -2.9), 3.0)  # hides a part of it
    lines = _facades([wall, post], seed)
    assert len(lines) == 1
    assert lines.kind[0] == LandmarkKind.FACADE
    start, along = np.array(wall.start), np.subtract(wall.end, wall.start)
    along = along / np.hypot(*along)
    normal = np.array([-along[1], along[0]])
    off = (lines.middle_vehicle_m[0] - start) @ normal
    assert abs(off) < 3.0 * lines.offset_sd_m[0]
    turned = wrap_angle(2.0 * (lines.direction_rad[0] - np.arctan2(along[1], along[0]))) / 2.0
    assert abs(turned) < 3.0 * lines.direction_sd_rad[0]
    assert lines.offset_sd_m[0] < 0.2
    assert lines.length_m[0] > 3.0


def test_what_is_low_or_narrow_and_a_plain_road_are_none() -> None:
    for walls in ([Wall((8.0, -5.0), (22.0, -5.0), 1.6)], [Wall((9.0, -3.0), (9.0, -5.0))], []):
        assert len(_facades(walls, 3)) == 0


def test_two_walls_that_meet_are_two_lines() -> None:
    court = [Wall((8.0, -4.0), (16.0, -4.0)), Wall((16.0, -4.0), (16.0, 2.0))]
    lines = _facades(court, 4)
    turned = np.abs(wrap_angle(lines.direction_rad))
    turned = np.minimum(turned, np.pi - turned)
    assert (turned < np.radians(12)).any()
    assert (turned > np.radians(78)).any()
