"""Markings and kerbs on roads made here, and what must not be taken for one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from polemap.detect.ground import Ground, fit_ground
from polemap.detect.lines.find import find_lines
from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle
from polemap.drivelog.line_detections import LineDetections
from polemap.vehicle.pose import rotate_back
from tests.polemap.detect.lines.scenes import RIG, Scene

Floats = NDArray[np.float64]
Light = Callable[[Floats, Floats], Floats]
BOTH = frozenset({LandmarkKind.LANE_MARKING, LandmarkKind.KERB})


def _found(scene: Scene) -> LineDetections:
    image, maps = scene.take()
    lines = find_lines(image, maps, fit_ground(maps, RIG), RIG, BOTH)
    assert lines is not None
    return lines


def _from_camera(points_m: Floats) -> Floats:
    """Points of the vehicle frame, ahead and left of the camera's foot."""
    mount = RIG.vehicle_from_camera
    return rotate_back(points_m - np.array([mount.x_m, mount.y_m]), mount.yaw_rad)


def _check(lines: LineDetections, offset_m: float, slope: float, sds: float = 3.0) -> None:
    """Every piece lies on y = offset + slope x within its deviations."""
    middle = _from_camera(lines.middle_vehicle_m)
    off = (middle[:, 1] - offset_m - slope * middle[:, 0]) / np.hypot(1.0, slope)
    turned = lines.direction_rad - RIG.vehicle_from_camera.yaw_rad - np.arctan(slope)
    assert (np.abs(off) < sds * lines.offset_sd_m).all()
    assert (np.abs(turned) < sds * lines.direction_sd_rad).all()


def _stripe(offset_m: float, slope: float = 0.0, width_m: float = 0.12, paint: float = 160.0,
            dash_m: tuple[float, float] | None = None) -> Light:  # fmt: skip
    def light(x: Floats, y: Floats) -> Floats:
        on = np.abs(y - offset_m - slope * x) < 0.5 * width_m
        if dash_m is not None:
            on &= x % sum(dash_m) < dash_m[0]
        return np.where(on, paint, 90.0)

    return light


@pytest.mark.parametrize(("offset_m", "slope"), [(1.75, 0.0), (-1.75, 0.03), (2.5, -0.06)])
@pytest.mark.parametrize("paint", [115.0, 180.0])
def test_a_solid_marking_is_found_where_it_is(offset_m: float, slope: float, paint: float) -> None:
    lines = _found(Scene(light=_stripe(offset_m, slope, paint=paint)))
    assert len(lines) >= 2
    assert (lines.kind == LandmarkKind.LANE_MARKING).all()
    assert (lines.style == LineStyle.SOLID).all()
    assert (lines.offset_sd_m < 0.08).all()
    assert (lines.probability > 0.7).all()
    _check(lines, offset_m, slope)
    # no stretch twice
    reach = np.sort(_from_camera(np.vstack([lines.start_vehicle_m, lines.end_vehicle_m]))[:, 0])
    assert lines.length_m.sum() <= np.ptp(reach) + 0.3


def test_dashes_are_told_from_a_solid_line() -> None:
    lines = _found(Scene(light=_stripe(1.75, dash_m=(3.0, 5.0))))
    assert len(lines) >= 2
    assert (lines.style == LineStyle.DASHED).all()
    _check(lines, 1.75, 0.0)


def test_a_double_line_is_one_line() -> None:
    def light(x: Floats, y: Floats) -> Floats:
        return np.maximum(_stripe(1.6)(x, y), _stripe(1.95)(x, y))

    lines = _found(Scene(light=light))
    assert (lines.style == LineStyle.DOUBLE).any()
    double = lines.take(lines.style == LineStyle.DOUBLE)
    _check(double, 1.775, 0.0)


def _shadow_edge(x: Floats, y: Floats) -> Floats:
    return np.where(y > 1.5 + 0.02 * x, 40.0, 140.0)


def _gap_between_shadows(x: Floats, y: Floats) -> Floats:
    return np.where(np.abs(y - 1.5) < 0.45, 140.0, 45.0)


def _tar_seam(x: Floats, y: Floats) -> Floats:
    return np.where(np.abs(y - 1.0) < 0.06, 40.0, 95.0)


def _two_tar_seams(x: Floats, y: Floats) -> Floats:
    return np.where(np.abs(np.abs(y - 1.0) - 0.25) < 0.05, 50.0, 110.0)


def _patch(x: Floats, y: Floats) -> Floats:
    return np.where(np.abs(y) < 0.8, 130.0, 90.0)


def _leaves(x: Floats, y: Floats) -> Floats:
    cell = np.floor(x / 0.4).astype(np.int64) * 31 + np.floor(y / 0.25).astype(np.int64) * 17
    return np.where((cell * 2654435761 >> 7) % 3 == 0, 140.0, 50.0)


@pytest.mark.parametrize(
    "light", [_shadow_edge, _gap_between_shadows, _tar_seam, _two_tar_seams, _patch, _leaves]
)
def test_what_is_no_marking(light: Light) -> None:
    assert len(_found(Scene(light=light))) == 0


@pytest.mark.parametrize(("kerb_m", "slope"), [(3.0, 0.0), (2.2, 0.05), (3.5, -0.04)])
@pytest.mark.parametrize("step_m", [0.10, 0.15])
def test_a_kerb_is_found_by_its_step(kerb_m: float, slope: float, step_m: float) -> None:
    lines = _found(Scene(kerb_m=kerb_m, kerb_slope=slope, step_m=step_m))
    assert len(lines) >= 1
    assert (lines.kind == LandmarkKind.KERB).all()
    assert (lines.offset_sd_m <= 0.2).all()
    _check(lines, kerb_m, slope)


def test_a_bright_kerbstone_is_a_kerb_only() -> None:
    lines = _found(Scene(kerb_m=3.0, step_m=0.12, light=_stripe(3.1, width_m=0.2)))
    assert len(lines) >= 1
    assert (lines.kind == LandmarkKind.KERB).all()


@pytest.mark.parametrize(
    "scene",
    [
        Scene(kerb_m=3.0, step_m=0.02),  # a seam of the paving
        Scene(kerb_m=3.0, step_m=0.45),  # a wall's top, a bed
        Scene(wall_m=3.0),  # a hedge's foot
        Scene(wall_m=5.0, wall_height_m=2.5),
        Scene(light=_shadow_edge),
    ],
    ids=["low", "high", "hedge", "house", "shadow"],
)
def test_what_is_no_kerb(scene: Scene) -> None:
    assert not (_found(scene).kind == LandmarkKind.KERB).any()


def test_only_the_kinds_that_are_asked_for() -> None:
    image, maps = Scene(kerb_m=3.0, step_m=0.12, light=_stripe(-1.75)).take()
    ground = fit_ground(maps, RIG)
    for kind in BOTH:
        lines = find_lines(image, maps, ground, RIG, frozenset({kind}))
        assert lines is not None
        assert len(lines) > 0
        assert (lines.kind == kind).all()


def test_without_a_road_there_is_no_word_of_lines() -> None:
    image, maps = Scene(light=_stripe(1.75)).take()
    ground = Ground(-65.0, 0.0, 0.3, fitted=False)
    assert find_lines(image, maps, ground, RIG, BOTH) is None
