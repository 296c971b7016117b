"""Lines and corners of point drives: where they lie, how they err, what they leave alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.simulate.config import CornerDetectorConfig, LineDetectorConfig
from polemap.simulate.line_detector import LineDetector
from polemap.simulate.points.drive import PointScenario, simulate_points
from polemap.simulate.street_lines import Repaint, Street

PLAIN = PointScenario(duration_s=8.0)
ALL = replace(PLAIN, street=Street(), lines=LineDetectorConfig(), corners=CornerDetectorConfig())


def test_poles_are_seen_alike_with_and_without_further_kinds() -> None:
    bare, full = (simulate_points(s, np.random.default_rng(4)) for s in (PLAIN, ALL))
    for one, other in zip(bare.scans, full.scans, strict=True):
        poles = other.of_kinds(LandmarkKind.POLE)
        np.testing.assert_array_equal(one.points_vehicle_m, poles.points_vehicle_m)
        assert one.lines is None
        assert other.lines is not None
    n = len(bare.pole_map)
    np.testing.assert_array_equal(bare.pole_map.points_m, full.pole_map.points_m[:n])
    assert (full.pole_map.kind[n:] == LandmarkKind.CORNER).all()
    assert full.pole_map.lines is not None


@pytest.mark.parametrize("name", ["frame_share", "lasting_share"])
def test_errors_have_the_stated_size_and_share(name: str) -> None:
    road = np.stack([np.arange(0.0, 200.0, 0.5), np.zeros(400)], axis=1)
    street = Street(wander_m=0.0, centre=2, house_spacing_m=np.inf)
    lines = street.lines(road, np.random.default_rng(0))
    shares = {"frame_share": 0.0, "lasting_share": 0.0, name: 0.6}
    config = LineDetectorConfig(
        clutter_per_scan=0.0, direction_sd_rad=1e-6, lasting_s=0.5, detected_share=1.0, **shares
    )
    detector = LineDetector(lines, config, np.random.default_rng(1))
    truth = np.array([1.75, -1.75, 5.25, -2.25, 5.75])
    errors = []
    for k in range(1500):
        seen = detector.scan(0.5 * k, np.array([50.0, 0.0, 0.0])).take(slice(None))
        across = seen.middle_vehicle_m[:, 1]
        offset = across - truth[np.abs(across[:, None] - truth).argmin(axis=1)]
        # the first window of each line, so that two kerbs are a pair
        kerbs = (seen.kind == LandmarkKind.KERB) & (seen.middle_vehicle_m[:, 0] < 8.0)
        errors.append((offset / seen.offset_sd_m)[kerbs])
    pairs = np.array(errors)
    assert pairs.shape == (1500, 2)
    # 3000 draws, most of them shared by two: the sd of a variance is below 0.05
    assert np.mean(pairs**2) == pytest.approx(1.0, abs=0.15)
    assert np.mean(pairs[:, 0] * pairs[:, 1]) == pytest.approx(0.6, abs=0.12)


def test_a_repainted_road_is_seen_beside_its_map() -> None:
    paint = Street(repaint=Repaint(0.6), wander_m=0.0, map_sd_m=0.0)
    made = simulate_points(replace(ALL, street=paint), np.random.default_rng(2))
    assert made.pole_map.lines is not None
    for row, line in enumerate(made.street.lines):
        mapped = made.pole_map.lines.polyline_m(row)
        apart = np.hypot(*(line.points_m[::10][: len(mapped) - 1] - mapped[:-1]).T)
        expected = 0.6 if line.kind == LandmarkKind.LANE_MARKING else 0.0
        np.testing.assert_allclose(apart, expected, atol=1e-6)


def test_no_pole_stands_beside_the_bare_part() -> None:
    bare = replace(PLAIN, without_poles_m=(0.0, np.inf))
    made = simulate_points(bare, np.random.default_rng(3))
    assert len(made.pole_map) == 0
    part = simulate_points(replace(PLAIN, without_poles_m=(0.0, 30.0)), np.random.default_rng(3))
    whole = simulate_points(PLAIN, np.random.default_rng(3))
    assert 0 < len(part.pole_map) < len(whole.pole_map)


def test_corners_face_along_the_street_and_are_seen_where_they_stand() -> None:
    made = simulate_points(ALL, np.random.default_rng(5))
    facing = made.street.corners.facing_rad
    assert len(facing)
    seen = 0
    for scan in made.scans:
        corners = scan.of_kinds(LandmarkKind.CORNER)
        assert np.isfinite(corners.facing_rad).all()
        seen += len(corners)
    assert seen > 0
