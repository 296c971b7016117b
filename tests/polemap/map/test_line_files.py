"""Lines of a map in its files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.io import read_map, write_map
from polemap.map.line_map import LineMap
from polemap.map.pole_map import PoleMap


def _map(frame: EarthFrame, origin: tuple[float, float]) -> PoleMap:
    rng = np.random.default_rng(3)
    lines = LineMap(
        frame=frame, vertices_m=rng.uniform(0, 99, (7, 2)) + origin,
        vertex_sd_m=rng.uniform(0.02, 0.2, 7), ids=np.array([4, 9]),
        kind=np.array([2, 3], dtype=np.int8), style=np.array([3, 0], dtype=np.int8),
        count=np.array([3, 4]), observations=np.array([30, 7]), drives=np.array([2, 1]),
        existence=np.array([0.98, 0.7]),
    )  # fmt: skip
    one = PoleMap(
        frame, np.array([4]), np.array([origin]) + 5.0, np.eye(2)[None] * 0.01, np.array([0.2]),
        np.array([np.nan]), np.array([9]), np.array([1]), np.array([0.9]),
    )  # fmt: skip
    return replace(one, lines=lines)


@pytest.mark.parametrize("ending", ["gpkg", "geojson"])
@pytest.mark.parametrize(
    ("frame", "origin"),
    [(EarthFrame("utm", 32633), (388500.0, 5819500.0)),
     (EarthFrame("local", name="y"), (0.0, 0.0))],
)  # fmt: skip
def test_lines_come_back_beside_the_poles(
    tmp_path: Path, ending: str, frame: EarthFrame, origin: tuple[float, float]
) -> None:
    made = _map(frame, origin)
    write_map(made, tmp_path / f"m.{ending}")
    write_map(made, tmp_path / f"m.{ending}")  # its own layers are no one else's
    again = read_map(tmp_path / f"m.{ending}")
    assert len(again) == 1
    assert again.lines is not None
    assert made.lines is not None
    assert again.lines.frame == frame
    np.testing.assert_array_equal(again.lines.vertices_m, made.lines.vertices_m)
    np.testing.assert_array_equal(again.lines.vertex_sd_m, made.lines.vertex_sd_m)
    for name, values in made.lines.arrays().items():
        np.testing.assert_array_equal(again.lines.arrays()[name], values, err_msg=name)


def test_a_kind_that_is_none_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.geojson"
    write_map(_map(EarthFrame("local", name="y"), (0.0, 0.0)), path)
    document = json.loads(path.read_text())
    document["features"][1]["properties"]["kind"] = "hedge"
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match="line 4: its kind is 'hedge'; write one of"):
        read_map(path)
