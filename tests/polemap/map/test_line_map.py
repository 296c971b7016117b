"""Lines of a map: columns, pieces near a place, other frames."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle
from polemap.map.line_map import LineMap, join_lines

UTM = EarthFrame("utm", epsg=32633)
VERTICES_M = [[0.0, 0.0], [10.0, 0.0], [20.0, 5.0], [0.0, 8.0], [0.0, 30.0]]
ORIGIN_M = np.array([500_000.0, 5_400_000.0])


def two_lines() -> LineMap:
    return LineMap(
        frame=UTM,
        vertices_m=ORIGIN_M + np.array(VERTICES_M),
        vertex_sd_m=np.array([0.1, 0.2, 0.1, 0.3, 0.3]),
        ids=np.array([7, 9]),
        kind=np.array([LandmarkKind.LANE_MARKING, LandmarkKind.KERB], dtype=np.int8),
        style=np.array([LineStyle.DASHED, LineStyle.UNKNOWN], dtype=np.int8),
        count=np.array([3, 2]),
        observations=np.array([4, 5]),
        drives=np.array([1, 2]),
        existence=np.array([0.9, 0.8]),
    )


def test_pieces_never_join_two_lines() -> None:
    pieces = two_lines().segments
    assert pieces.line.tolist() == [0, 0, 1]
    assert pieces.sd_m.tolist() == [0.2, 0.2, 0.3]
    np.testing.assert_array_equal(pieces.end_m[0], pieces.start_m[1])


def test_within_finds_what_passes_near_although_its_middle_is_far() -> None:
    lines = two_lines()
    assert lines.within((500_000.0, 5_400_028.0), 1.0).tolist() == [2]
    assert lines.within((500_001.0, 5_400_000.5), 1.0).tolist() == [0]
    assert len(LineMap.empty(UTM).within((500_000.0, 5_400_000.0), 50.0)) == 0


def test_take_and_join_keep_each_line_with_its_vertices() -> None:
    lines = two_lines()
    kerb = lines.take(lines.kind == LandmarkKind.KERB)
    np.testing.assert_array_equal(kerb.polyline_m(0), lines.polyline_m(1))
    again = join_lines([kerb, lines.take(np.array([0]))])
    assert again.ids.tolist() == [9, 7]
    np.testing.assert_array_equal(again.polyline_m(1), lines.polyline_m(0))


def test_another_zone_and_back() -> None:
    lines = two_lines()
    there = lines.to_frame(EarthFrame("utm", epsg=32632))
    assert np.hypot(*(there.vertices_m - lines.vertices_m).T).min() > 1000.0
    np.testing.assert_allclose(there.to_frame(UTM).vertices_m, lines.vertices_m, atol=1e-4)


def test_what_is_no_line_is_refused() -> None:
    lines = two_lines()
    with pytest.raises(InputError, match="less than two vertices"):
        LineMap(
            frame=UTM, vertices_m=lines.vertices_m, vertex_sd_m=lines.vertex_sd_m,
            **{**lines.arrays(), "count": np.array([4, 1])},
        )  # fmt: skip
    bad = lines.vertices_m.copy()
    bad[4, 0] = np.nan
    with pytest.raises(InputError, match="line 9 has a vertex that is not finite"):
        LineMap(frame=UTM, vertices_m=bad, vertex_sd_m=lines.vertex_sd_m, **lines.arrays())
