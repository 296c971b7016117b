"""Whose file it is, by what stands in it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import OutputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.results.signature import check_signature
from polemap.drivelog.writers.trajectory import write_trajectory
from polemap.map.io import export_map
from polemap.vehicle.trajectory import Trajectory
from tests.pole_maps import plain_map

FRAME = EarthFrame("utm", 32632)
POINTS = np.array([[690_000.0, 5_330_000.0], [690_010.0, 5_330_002.0]])


@pytest.mark.parametrize("ending", [".gpx", ".geojson"])
def test_a_trajectory_is_known_again(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    poses = np.column_stack([POINTS, [0.1, 0.2]])
    write_trajectory(path, Trajectory(np.array([1.0, 2.0]), poses), FRAME, "a")
    check_signature(path)
    path.write_text(path.read_text().replace("polemap", "others"))
    with pytest.raises(OutputError, match="was not written by polemap"):
        check_signature(path)


@pytest.mark.parametrize("ending", [".osm", ".geojson", ".parquet"])
def test_a_map_replaces_its_like_alone(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    pole_map = replace(plain_map(POINTS), frame=FRAME)
    for _ in range(2):
        export_map(pole_map, path)
    path.write_bytes(path.read_bytes().replace(b"polemap", b"others!"))
    before = path.read_bytes()
    with pytest.raises(OutputError, match="was not written by polemap"):
        export_map(pole_map, path)
    assert path.read_bytes() == before
    path.write_bytes(b"")
    export_map(pole_map, path)
