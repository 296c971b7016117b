"""What is in the picture of a map."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.landmark_kind import LandmarkKind, LineStyle
from polemap.map.line_map import LineMap
from polemap.map.pole_map import KIND_COLUMN
from polemap.tools import map_picture
from tests.pole_maps import plain_map


def test_lines_beyond_the_last_pole_and_other_kinds_are_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    corners = np.array([LandmarkKind.POLE, LandmarkKind.CORNER], dtype=np.int8)
    points = plain_map([[0.0, 5.0], [20.0, 5.0]])
    kerb = LineMap(
        frame=points.frame, vertices_m=np.array([[0.0, 4.0], [300.0, 4.0]]),
        vertex_sd_m=np.full(2, 0.1),
        ids=np.array([0]), kind=np.array([LandmarkKind.KERB], dtype=np.int8),
        style=np.array([LineStyle.UNKNOWN], dtype=np.int8), count=np.array([2]),
        observations=np.array([9]), drives=np.array([1]), existence=np.array([0.9]),
    )  # fmt: skip
    seen: list[np.ndarray] = []
    extent = map_picture._extent

    def watched(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        seen.append(places)
        return extent(places)

    monkeypatch.setattr(map_picture, "_extent", watched)
    pole_map = replace(points, lines=kerb, extra={KIND_COLUMN: corners})
    map_picture.draw_map(pole_map, [], tmp_path / "m.svg")
    assert np.ptp(seen[0][:, 0]) == 300.0
    drawn = (tmp_path / "m.svg").read_text()
    for word in ("corner", "kerb", "1 pole, 1 corner, 1 kerb"):
        assert f"<!-- {word}" in drawn
