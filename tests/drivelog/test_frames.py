"""Frames of the earth: convergence and scale against what small steps on the ground do."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod

from polemap.drivelog.errors import FrameError, InputError
from polemap.drivelog.frames import (
    EarthFrame,
    convergence_rad,
    geographic_from_grid,
    grid_from_geographic,
    grid_yaw,
    point_scale,
    require_same_frame,
    transform_points,
    utm_frame,
)

LOCAL = EarthFrame("local", name="yard")
latitudes = st.floats(-75.0, 80.0)
longitudes = st.floats(-179.9, 179.9)


@given(latitudes, longitudes)
def test_there_and_back(latitude: float, longitude: float) -> None:
    frame = utm_frame(latitude, longitude)
    back = geographic_from_grid(frame, grid_from_geographic(frame, [latitude], [longitude]))
    np.testing.assert_allclose(back, [[latitude, longitude]], atol=1e-8)


@given(latitudes, longitudes, st.floats(-np.pi, np.pi))
def test_a_step_on_the_ground_shows_yaw_and_scale(
    latitude: float, longitude: float, yaw: float
) -> None:
    """An oracle that knows no projection formula: walk 20 m by geodesic and look at the grid."""
    frame = utm_frame(latitude, longitude)
    azimuth = 90.0 - np.degrees(yaw)
    east, north, _ = Geod(ellps="WGS84").fwd(longitude, latitude, azimuth, 20.0)
    start = grid_from_geographic(frame, [latitude], [longitude])
    step = (grid_from_geographic(frame, [north], [east]) - start)[0]
    walked = np.arctan2(step[1], step[0])
    difference = (walked - grid_yaw(frame, [yaw], start)[0] + np.pi) % (2 * np.pi) - np.pi
    assert abs(difference) < 2e-6
    assert np.hypot(*step) / 20.0 == pytest.approx(point_scale(frame, start)[0], abs=2e-6)


def test_convergence_is_zero_on_the_central_meridian_and_grows_to_the_east() -> None:
    frame = EarthFrame("utm", 32632)
    points = grid_from_geographic(frame, [49.0, 49.0], [9.0, 10.0])
    at_middle, to_east = convergence_rad(frame, points)
    assert at_middle == pytest.approx(0.0, abs=1e-12)
    assert to_east == pytest.approx(np.radians(1.0) * np.sin(np.radians(49.0)), rel=1e-3)


@pytest.mark.parametrize(
    ("latitude", "longitude", "epsg"),
    [
        (49.0, 8.4, 32632),
        (60.0, 5.0, 32632),  # Norway
        (78.0, 15.0, 32633),  # Svalbard
        (-33.9, 151.2, 32756),
        (52.5, 180.0, 32601),
    ],
)
def test_zones(latitude: float, longitude: float, epsg: int) -> None:
    assert utm_frame(latitude, longitude).epsg == epsg


def test_no_zone_at_the_pole() -> None:
    with pytest.raises(InputError, match="lies in no UTM zone"):
        utm_frame(88.0, 10.0)


def test_neighbouring_zones_transform_and_local_frames_do_not() -> None:
    west, east = EarthFrame("utm", 32632), EarthFrame("utm", 32633)
    points = np.array([[760000.0, 5_430_000.0], [760100.0, 5_430_000.0]])
    there = transform_points(points, west, east)
    np.testing.assert_allclose(transform_points(there, east, west), points, atol=1e-6)
    np.testing.assert_allclose(
        geographic_from_grid(west, points), geographic_from_grid(east, there), atol=1e-10
    )
    with pytest.raises(FrameError, match="no transformation leads from local frame 'yard'"):
        transform_points(points, LOCAL, west)
    with pytest.raises(FrameError, match="is not tied to the earth"):
        geographic_from_grid(LOCAL, points)


def test_two_frames_are_refused_by_name() -> None:
    require_same_frame(LOCAL, LOCAL, "map", "drive")
    with pytest.raises(FrameError, match=r"map.gpkg is in EPSG:32632 but drive x is in local"):
        require_same_frame(EarthFrame("utm", 32632), LOCAL, "map.gpkg", "drive x")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"kind": "utm", "epsg": 4326}, "no UTM zone"),
        ({"kind": "utm", "epsg": "32632"}, "must be a whole number"),
        ({"kind": "utm"}, "no UTM zone"),
        ({"kind": "local"}, "needs a name"),
        ({"kind": "flat"}, "known are 'utm' and 'local'"),
        ({"kind": "local", "name": "a", "zone": 3}, "unknown key 'zone'"),
    ],
)
def test_frames_that_are_none(values: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        EarthFrame.from_dict(values)


def test_a_frame_survives_its_dict() -> None:
    for frame in (LOCAL, EarthFrame("utm", 32756)):
        assert EarthFrame.from_dict(frame.to_dict()) == frame
