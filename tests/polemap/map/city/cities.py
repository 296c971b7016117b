"""A city for the tests of maps that are opened by tiles."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.frames import EarthFrame
from polemap.map.city.city_map import CityMap
from polemap.map.city.geopackage.io import TILE_M
from polemap.map.pole_map import PoleMap
from tests.pole_maps import plain_map

ORIGIN = np.array([450_000.0, 5_400_000.0])
SIDE_M, COUNT = 3000.0, 4000


def make_city(seed: int = 0, count: int = COUNT) -> PoleMap:
    """Poles in no order; some exactly on the borders of tiles, and at their corners."""
    rng = np.random.default_rng(seed)
    points = ORIGIN + rng.uniform(0.0, SIDE_M, (count, 2))
    points[:40, 0] = ORIGIN[0] + TILE_M * (1 + np.arange(40) % 5)
    points[20:60, 1] = ORIGIN[1] + TILE_M * (1 + np.arange(40) % 4)
    plain = plain_map(points)
    return replace(
        plain,
        frame=EarthFrame("utm", 32633),
        ids=rng.permutation(count) + 7,
        width_m=np.where(rng.random(count) < 0.3, np.nan, rng.uniform(0.1, 0.5, count)),
        existence=rng.uniform(0.2, 1.0, count),
        extra={"history": np.array([f'"{i}"' for i in range(count)])},
    )


def by_id(pole_map: PoleMap) -> PoleMap:
    return pole_map.rows(np.argsort(pole_map.ids, kind="stable"))


def assert_same(first: PoleMap, second: PoleMap) -> None:
    assert first.frame == second.frame
    for name in ("ids", "points_m", "covariance_m2", "width_m", "observations", "drives",
                 "existence"):  # fmt: skip
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), name)


ENDINGS = pytest.mark.parametrize("ending", ["gpkg", "parquet"])


def damage(path: Path, opened: CityMap) -> Path:
    """Overwrites the middle of what holds the poles; whether in place is for the caller."""
    data = bytearray(path.read_bytes())
    if path.suffix == ".parquet":
        # row group 20 of 63, somewhere in the first two thirds, which hold the columns
        start = len(data) // 4
        data[start : start + 64] = bytes(64)
    else:
        with closing(sqlite3.connect(path)) as database:
            (size,) = database.execute("PRAGMA page_size").fetchone()
        page = next(
            n for n in range(len(data) // size // 3, len(data) // size) if data[n * size] == 13
        )
        data[page * size : page * size + 200] = b"\xff" * 200
    copy = path.with_name(f"damaged{path.suffix}")
    copy.write_bytes(bytes(data))
    return copy
