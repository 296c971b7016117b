"""Routes: closed lines turn once, lateral offsets are distances, sections slope as told."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polemap.drivelog.errors import ConfigError
from polemap.simulate.ground import kerb_m, make_section
from polemap.simulate.route import make_route
from polemap.simulate.scenario import SectionSpec

LOOP = [(0.0, 0.0), (80.0, 5.0), (90.0, 50.0), (-5.0, 55.0)]


def test_a_closed_route_turns_once_and_meets_itself() -> None:
    route = make_route(LOOP, 12.0, True)
    assert np.sum(route.curvature_1pm) * 0.25 == pytest.approx(2 * np.pi, rel=1e-3)
    gap = np.hypot(*(route.points_m[0] - route.points_m[-1]))
    assert gap == pytest.approx(0.25, rel=0.02)
    steps = np.hypot(*np.diff(route.points_m, axis=0).T)
    assert np.allclose(steps, 0.25, rtol=0.02)
    assert np.allclose(route.at(np.array(3.0)), route.at(np.array(3.0 + route.length_m)), atol=1e-6)


def test_curvature_stays_below_that_of_the_arcs() -> None:
    route = make_route(LOOP, 12.0, True)
    assert np.abs(route.curvature_1pm).max() < 1.05 / 12.0


@settings(max_examples=40)
@given(st.floats(0, 500), st.floats(-6, 6))
def test_a_lateral_offset_is_a_distance_to_the_left(station: float, lateral: float) -> None:
    route = make_route(LOOP, 12.0, True)
    middle, beside = route.at(np.array(station)), route.at(np.array(station), lateral)
    offset = beside[:2] - middle[:2]
    left = np.array([-np.sin(middle[2]), np.cos(middle[2])])
    assert offset @ left == pytest.approx(lateral, abs=1e-9)
    assert np.hypot(*offset) == pytest.approx(abs(lateral), abs=1e-9)


def test_an_open_route_keeps_its_ends() -> None:
    route = make_route([(0, 0), (60, 0), (60, 40)], 10.0, False)
    assert np.allclose(route.points_m[0], (0, 0), atol=0.05)
    assert np.allclose(route.points_m[-1], (60, 40), atol=0.3)


def test_legs_shorter_than_their_arcs_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"leg of 10\.0 m at corner .* lengthen it or reduce"):
        make_route([(0, 0), (10, 0), (10, 40), (0, 40)], 8.0, True)


@given(st.floats(0.0, 0.06), st.floats(2.5, 6.0))
def test_the_road_falls_to_both_sides(crossfall: float, half: float) -> None:
    spec = SectionSpec(crossfall=crossfall, road_half_width_m=half)
    section = make_section(spec)
    assert np.all(np.diff(section.lateral_m) > 0)
    assert len(section.surface) == len(section.lateral_m) - 1
    assert section.slope_at(1.2) == pytest.approx(-crossfall, abs=1e-6)
    assert section.slope_at(-1.2) == pytest.approx(crossfall, abs=1e-6)
    step = section.height_at(kerb_m(spec) + 0.05) - section.height_at(kerb_m(spec) - 0.01)
    assert step == pytest.approx(spec.kerb_height_m, abs=0.005)


def test_a_median_stands_above_the_lanes() -> None:
    section = make_section(SectionSpec(median_width_m=3.0, road_half_width_m=11.0))
    assert section.height_at(0.0) - section.height_at(1.6) == pytest.approx(0.11, abs=0.005)
