"""What changed between two maps, kind by kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from polemap.build.map_diff import compare_maps
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.map.line_map import LineMap
from polemap.map.pole_map import KIND_COLUMN, PoleMap
from tests.pole_maps import plain_map


def _with_lines(points: PoleMap, offsets_m: list[float], kinds: list[LandmarkKind]) -> PoleMap:
    n = len(kinds)
    ends = [[[0.0, y], [90.0, y]] for y in offsets_m]
    lines = LineMap(
        frame=points.frame, vertices_m=np.array(ends).reshape(-1, 2), count=np.full(n, 2),
        vertex_sd_m=np.full(2 * n, 0.1), ids=np.arange(n), kind=np.array(kinds, dtype=np.int8),
        style=np.zeros(n, dtype=np.int8), observations=np.full(n, 9), drives=np.full(n, 1),
        existence=np.full(n, 0.9),
    )  # fmt: skip
    return replace(points, lines=lines)


def test_lines_are_compared_within_their_kind() -> None:
    marking, kerb = LandmarkKind.LANE_MARKING, LandmarkKind.KERB
    points = plain_map([[0.0, 9.0]])
    before = _with_lines(points, [0.0, 4.0, 8.0], [marking, kerb, kerb])
    after = _with_lines(points, [0.3, 4.0, 11.0], [marking, marking, kerb])
    diff = compare_maps(before, after)
    assert diff.lines_removed.tolist() == [1, 2]
    assert diff.lines_added.tolist() == [1, 2]
    assert diff.lines_same == 1
    none = compare_maps(before, points)
    assert none.lines_removed.tolist() == [0, 1, 2]
    assert none.lines_same == 0


def test_a_corner_where_a_pole_stood_is_another_thing() -> None:
    before = plain_map([[0.0, 9.0], [30.0, 9.0]])
    kinds = np.array([LandmarkKind.POLE, LandmarkKind.CORNER], dtype=np.int8)
    diff = compare_maps(before, replace(before, extra={KIND_COLUMN: kinds}))
    assert diff.same.tolist() == [[0, 0]]
    assert diff.removed.tolist() == diff.added.tolist() == [1]
