"""The lane's truth: by the geometry of a straight and of an arc."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.simulate.driver import Motion
from polemap.simulate.lane_truth import lane_truth
from polemap.simulate.route import make_route
from polemap.simulate.scenario import SectionSpec

SPEC = SectionSpec(road_half_width_m=3.9, edge_line=True, lane_width_m=3.5)
LANE = 3.9 - 0.375  # centre line to edge line


def standing(pose: list[float], station: float, lateral: float) -> Motion:
    two = np.ones(2)
    return Motion(
        np.array([0.0, 1.0]), np.tile(pose, (2, 1)), two, 0 * two, 0 * two, 0 * two, 0 * two,
        lateral * two, 0 * two, station * two, np.zeros(2),
    )  # fmt: skip


def test_on_a_straight_it_is_the_cars_place_and_heading() -> None:
    route = make_route([(0.0, 0.0), (200.0, 0.0)], 10.0, closed=False)
    heading, lateral = 0.02, -1.5
    row = lane_truth(route, SPEC, standing([60.0, lateral, heading], 60.0, lateral),
                     np.array([0.5]), 11.0)[0]  # fmt: skip
    assert row[1] == pytest.approx(heading, abs=1e-6)
    # perpendicular to the lane: the place of the preview point across it
    assert row[2] == pytest.approx(lateral + 11.0 * np.sin(heading) + LANE / 2, abs=1e-5)
    assert row[3:5] == pytest.approx([0.0, LANE], abs=1e-6)


def test_on_an_arc_it_is_the_circles() -> None:
    route = make_route([(0.0, 0.0), (300.0, 0.0), (300.0, 300.0)], 120.0, closed=False)
    station = 180.0 + 0.25 * np.pi * 120.0
    lateral = -LANE / 2
    pose = route.at(np.array(station), lateral)
    row = lane_truth(route, SPEC, standing(pose.tolist(), station, lateral), np.array([0.5]), 10.0)[
        0
    ]
    radius = 120.0 - lateral
    assert row[3] == pytest.approx(1.0 / radius, rel=0.01)
    assert row[1] == pytest.approx(-np.arcsin(10.0 / radius), abs=2e-3)
    assert row[4] == pytest.approx(LANE, abs=0.02)


def test_beside_the_markings_there_is_none() -> None:
    route = make_route([(0.0, 0.0), (200.0, 0.0)], 10.0, closed=False)
    rows = lane_truth(route, SPEC, standing([60.0, -3.8, 0.0], 60.0, -3.8), np.array([0.5]), 11.0)
    assert np.isnan(rows[0, 1:5]).all()
