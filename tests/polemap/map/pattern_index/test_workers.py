"""The index on workers of any number and kind, of which some are lost on the way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dask.distributed import LocalCluster

from polemap.build.city.cluster import open_cluster
from polemap.build.city.work import on_workers
from polemap.drivelog.jobs import LocalWorkers, Workers
from polemap.map.city.parquet.io import write_tiles
from polemap.map.pattern_index.io import index_file, write_index
from tests.city_maps import opened
from tests.pole_maps import plain_map
from tests.polemap.build.city_tasks import die_once

Run = Callable[[Callable[[Any], Any], Sequence[Any]], list[Any]]

# six tiles of the index, and more of the map
POINTS = np.random.default_rng(8).uniform(0.0, (6000.0, 4000.0), (3000, 2))


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    path = tmp_path / "city.parquet"
    write_tiles(plain_map(POINTS), path, 256)
    return path


def losing(workers: Workers, folder: Path) -> Run:
    """The first worker that begins a tile is killed."""
    run = on_workers(workers)

    def lossy(function: Callable[[Any], Any], tasks: Sequence[Any]) -> list[Any]:
        return run(partial(die_once, function, folder), tasks)

    return lossy


def index_bytes(map_file: Path, run: Run) -> bytes:
    index_file(map_file).unlink(missing_ok=True)
    write_index(opened(map_file), map_file, run=run)
    return index_file(map_file).read_bytes()


def test_the_index_is_the_same_for_any_number_of_workers_and_losses(
    map_file: Path, tmp_path: Path
) -> None:
    one = index_bytes(map_file, on_workers(LocalWorkers(1)))
    assert index_bytes(map_file, on_workers(LocalWorkers(3))) == one
    assert index_bytes(map_file, losing(LocalWorkers(2), tmp_path)) == one
    assert (tmp_path / "find_triangles.begun").exists()


def test_a_cluster_that_loses_a_worker_builds_the_same_index(
    map_file: Path, tmp_path: Path
) -> None:
    one = index_bytes(map_file, on_workers(LocalWorkers(1)))
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        open_cluster(cluster.scheduler_address) as client,
    ):
        assert index_bytes(map_file, losing(client, tmp_path)) == one
    assert (tmp_path / "find_triangles.begun").exists()
