"""Parallel building on real local clusters: the same rows, lost workers, killed coordinators."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dask.distributed import LocalCluster

from polemap.build.assemble import assemble_map
from polemap.build.city.cluster import open_cluster
from polemap.build.city.io import clear, read_checkpoint, write_checkpoint
from polemap.build.city.work import observe_all, on_workers
from polemap.build.config import MappingConfig
from polemap.build.drive_observations import DriveObservations
from polemap.drivelog.errors import ConfigError, InputError
from polemap.drivelog.jobs import LocalWorkers
from polemap.map.pole_map import PoleMap
from tests.polemap.build import city_tasks
from tests.polemap.town import FRAME

ROOT = Path(__file__).resolve().parents[3]


def mapped(parts: list[DriveObservations]) -> PoleMap:
    return assemble_map(parts, MappingConfig(), FRAME).pole_map


def assert_same_rows(one: PoleMap, other: PoleMap) -> None:
    assert len(one) > 5
    for name in ("ids", "points_m", "covariance_m2", "width_m", "observations", "existence"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(one.extra["history"], other.extra["history"])


@pytest.fixture(scope="module")
def single(tmp_path_factory: pytest.TempPathFactory) -> PoleMap:
    folder = tmp_path_factory.mktemp("single")
    return mapped([city_tasks.observe(task) for task in city_tasks.tasks(folder)])


def test_a_checkpoint_keeps_everything_and_only_for_its_key(tmp_path: Path) -> None:
    task = city_tasks.tasks(tmp_path)[0]
    part = city_tasks.observe(task)
    path = tmp_path / "c" / f"{task.key()}.npz"
    write_checkpoint(part, "key", path)
    back = read_checkpoint(path, "key")
    assert back is not None
    assert_same_rows(mapped([part]), mapped([back]))
    assert read_checkpoint(path, "another") is None
    assert read_checkpoint(tmp_path / "none.npz", "key") is None
    path.write_bytes(path.read_bytes()[:200])
    assert read_checkpoint(path, "key") is None
    clear(path.parent)
    assert not path.parent.exists()


def test_keys_name_the_computation(tmp_path: Path) -> None:
    one, two = city_tasks.tasks(tmp_path)
    assert one.key() != two.key()
    assert one.key() == city_tasks.tasks(tmp_path)[0].key()


@pytest.mark.slow
def test_a_lost_worker_is_survived_with_the_same_rows(tmp_path: Path, single: PoleMap) -> None:
    tasks = city_tasks.tasks(tmp_path)
    parts = observe_all(tasks, city_tasks.observe_but_die_once, tmp_path / "c", LocalWorkers(2))
    assert city_tasks.calls(tmp_path, "day 2") >= 2
    assert_same_rows(single, mapped(parts))
    # and once it is done, nothing is computed again
    before = city_tasks.calls(tmp_path, "day 1")
    again = observe_all(
        tasks[::-1], city_tasks.observe_but_die_once, tmp_path / "c", LocalWorkers(2)
    )
    assert city_tasks.calls(tmp_path, "day 1") == before
    assert_same_rows(single, mapped(again))


@pytest.mark.slow
def test_a_killed_coordinator_is_resumed(tmp_path: Path, single: PoleMap) -> None:
    command = [sys.executable, "-m", "tests.polemap.build.city_tasks", str(tmp_path)]
    run = subprocess.Popen(command, cwd=ROOT, start_new_session=True)
    try:
        limit = time.monotonic() + 120.0
        while not list((tmp_path / "checkpoints").glob("*.npz")):
            assert run.poll() is None, "the coordinator ended by itself"
            assert time.monotonic() < limit, "no checkpoint in two minutes"
            time.sleep(0.2)
    finally:
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()
    assert city_tasks.calls(tmp_path, "day 1") == 1
    tasks = city_tasks.tasks(tmp_path)
    parts = observe_all(tasks, city_tasks.observe, tmp_path / "checkpoints", LocalWorkers(1))
    assert city_tasks.calls(tmp_path, "day 1") == 1
    assert city_tasks.calls(tmp_path, "day 2") == 1
    assert_same_rows(single, mapped(parts))


@pytest.mark.slow
def test_tiles_are_merged_on_a_cluster_that_loses_workers(tmp_path: Path, single: PoleMap) -> None:
    """Drives and tiles on one cluster; a worker dies in each of the two rounds over the tiles."""
    config, merged = MappingConfig(), []
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        open_cluster(cluster.scheduler_address) as client,
    ):
        parts = observe_all(
            city_tasks.tasks(tmp_path), city_tasks.observe_but_die_once, tmp_path / "c", client
        )
        workers = on_workers(client, merged.append)

        def run(function: Callable[[Any], Any], tasks: Sequence[Any]) -> list[Any]:
            return workers(partial(city_tasks.die_once, function, tmp_path), tasks)

        tiled = assemble_map(parts[::-1], config, FRAME, run=run, tile_m=40.0).pole_map
    assert len(merged) > 10
    assert {path.name for path in tmp_path.glob("*.begun")} == {
        "pair_tile.begun",
        "merge_tile.begun",
    }
    assert_same_rows(single, tiled)


@pytest.mark.slow
def test_errors_of_a_drive_come_through(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"drive day \d: it is upside down"):
        observe_all(city_tasks.tasks(tmp_path), city_tasks.observe_badly, tmp_path, LocalWorkers(1))
    with (
        pytest.raises(ConfigError, match=r"--scheduler tcp://127.0.0.1:1: cannot be reached"),
        open_cluster("tcp://127.0.0.1:1"),
    ):
        pass
