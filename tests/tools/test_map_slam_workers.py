"""Drives without reference by workers: a killed build goes on, and nobody changes the result."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dask.distributed import LocalCluster

from polemap.build.city.work import DriveTask
from polemap.drivelog.frames import EarthFrame
from polemap.map.io import read_map
from polemap.tools import map_condensed
from polemap.tools.cli import run
from tests.polemap.build.slam.loops import beside, rounded, simulated, write_simulated

pytest.importorskip("gtsam")


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    place = tmp_path_factory.mktemp("drives")
    rng = np.random.default_rng(211)
    # a small block: every build solves it anew
    corners = np.array([[0.0, 0.0], [50.0, 0.0], [50.0, 35.0], [0.0, 35.0]])
    poses = rounded(corners, 0.8, 1.3)
    poles = beside(poses[:213], 6.0, rng)
    return [
        str(write_simulated(place / name, simulated(poses, poles, rng))) for name in ("ann", "bob")
    ]


def built(drives: list[str], out: Path, *more: str) -> int:
    return run(["map", *drives, "--slam", "--out", str(out), *more])


@pytest.fixture(scope="module")
def whole(drives: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole") / "map.gpkg"
    assert built(drives, out, "--workers", "1", "--poses", str(out.parent / "poses")) == 0
    return out


def assert_same(out: Path, whole: Path) -> None:
    one, other = read_map(out), read_map(whole)
    np.testing.assert_array_equal(one.points_m, other.points_m)
    np.testing.assert_array_equal(one.covariance_m2, other.covariance_m2)
    np.testing.assert_array_equal(
        one.extra["absolute_var_east_m2"], other.extra["absolute_var_east_m2"]
    )
    for name in ("ann", "bob"):
        first, second = ((path.parent / "poses" / f"{name}.tum") for path in (out, whole))
        assert first.read_text() == second.read_text()


@pytest.mark.parametrize(("stage", "left"), [("condense", 1), ("solve_condensed", 0)])
def test_a_killed_build_goes_on(
    drives: list[str], whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    stage: str, left: int,
) -> None:  # fmt: skip
    """Killed while the second drive is condensed, or while both are solved together."""
    out, calls = tmp_path / "map.gpkg", [0]
    arguments = ("--workers", "1", "--poses", str(tmp_path / "poses"))
    condense = map_condensed.condense

    def counted(*given: Any) -> Any:
        calls[0] += 1
        return condense(*given)

    def killed(*given: Any) -> Any:
        if stage == "condense" and not calls[0]:
            return counted(*given)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(map_condensed, "condense", counted)
        patch.setattr(map_condensed, stage, killed)
        assert built(drives, out, *arguments) != 0
    assert not out.exists()
    assert not (tmp_path / "poses").exists()
    calls[0] = 0
    monkeypatch.setattr(map_condensed, "condense", counted)
    assert built(drives, out, *arguments) == 0
    assert calls[0] == left
    assert_same(out, whole)
    assert not list(tmp_path.glob(".*checkpoints"))


@pytest.mark.slow
def test_workers_and_a_scheduler_give_the_same(
    drives: list[str], whole: Path, tmp_path: Path
) -> None:
    def check(place: Path, *more: str) -> None:
        place.mkdir()
        out = place / "map.gpkg"
        assert built(drives[::-1], out, "--poses", str(place / "poses"), *more) == 0
        assert_same(out, whole)

    check(tmp_path / "two", "--workers", "2")
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        check(tmp_path / "dask", "--scheduler", cluster.scheduler_address)


def test_an_update_by_workers_is_that_of_one_process(
    drives: list[str], whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def updated(name: str, *more: str) -> Path:
        out = tmp_path / name
        arguments = ["map", drives[0], "--update", str(whole), "--out", str(out), *more]
        assert run(arguments) == 0
        assert "drive ann was localized in the map: " in capsys.readouterr().out
        return out

    one, other = read_map(updated("1.gpkg")), read_map(updated("2.gpkg", "--workers", "1"))
    np.testing.assert_array_equal(one.points_m, other.points_m)
    np.testing.assert_array_equal(one.observations, other.observations)
    assert one.observations.sum() > 1.2 * read_map(whole).observations.sum()


def test_a_checkpoint_of_other_odometry_is_not_taken() -> None:
    def key(odometry: str) -> str:
        return DriveTask(
            "d", "d", None, 0, EarthFrame("local", name="yard"), "{}", None, odometry
        ).key()

    assert key("camera") != key("auto")
    assert key("camera") != key("wheels")
