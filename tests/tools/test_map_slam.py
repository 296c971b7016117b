"""`polemap map` of drives without reference poses, from the command line."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.build.map_diff import match_points
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.tum import read_tum
from polemap.map.io import read_map
from polemap.tools.cli import run
from polemap.tools.map_slam import file_stem
from polemap.vehicle.pose import rigid_fit, transform_points
from tests.polemap.build.slam.loops import Simulated, beside, block, simulated, write_simulated

pytest.importorskip("gtsam")


@pytest.fixture(scope="module")
def sim() -> Simulated:
    rng = np.random.default_rng(201)
    poses = block(2.2)
    return simulated(poses, beside(poses[:330], 6.0, rng), rng)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory, sim: Simulated) -> Path:
    place = tmp_path_factory.mktemp("slam")
    drive = write_simulated(place / "taxi", sim)
    arguments = ["map", str(drive), "--out", str(place / "map.gpkg"), "--poses", str(place / "p")]
    assert run(arguments) == 0
    return place


def test_it_is_chosen_where_a_drive_has_no_reference(
    built: Path, sim: Simulated, capsys: pytest.CaptureFixture[str]
) -> None:
    pole_map = read_map(built / "map.gpkg")
    assert np.isfinite(pole_map.extra["absolute_var_east_m2"]).mean() > 0.9
    trajectory = read_tum(built / "p" / "taxi.tum")
    truth = np.column_stack(
        [np.interp(trajectory.stamp_s, 0.1 * np.arange(len(sim.truth)), sim.truth[:, a])
         for a in (0, 1)]
    )  # fmt: skip
    laid = transform_points(rigid_fit(trajectory.poses[:, :2], truth), pole_map.points_m)
    pairs = match_points(laid, sim.poles.points_m, 0.5)
    assert len(pairs) >= 0.9 * len(pole_map)
    figures = json.loads((built / "p" / "slam.json").read_text())
    assert figures["loops"] > 3
    assert figures["drives"][0]["drive"] == "taxi"
    assert (
        run(
            [
                "map",
                str(built / "taxi"),
                "--out",
                str(built / "b.gpkg"),
                "--poses",
                str(built / "p"),
            ]
        )
        == 0
    )
    said = capsys.readouterr().out
    assert "note: drive taxi has no reference poses: they are estimated (--slam)" in said
    assert "built without reference:" in said


def test_the_poses_serve_as_a_reference_elsewhere(built: Path) -> None:
    copy = built / "copy"
    shutil.copytree(built / "taxi", copy)
    shutil.copy(built / "p" / "taxi.csv", copy / "reference.csv")
    reference = open_drive(copy).reference
    assert reference is not None
    assert (reference.sd_m > 0.0).all()
    assert run(["map", str(copy), "--out", str(built / "again.gpkg")]) == 0
    again, first = read_map(built / "again.gpkg"), read_map(built / "map.gpkg")
    assert len(match_points(again.points_m, first.points_m, 0.05)) >= 0.95 * len(first)


def test_an_update_localizes_in_the_old_map(
    built: Path, sim: Simulated, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(202)
    # the old map stands where its own fixes had it; its drive is the one that is given again
    second = built / "second"
    if not second.exists():
        write_simulated(second, replace(sim, drive=replace(sim.drive, reference=None)))
    del rng
    out = built / "updated.gpkg"
    arguments = ["map", str(second), "--update", str(built / "map.gpkg"), "--out", str(out)]
    assert run(arguments) == 0
    assert "was localized in the map" in capsys.readouterr().out
    before, after = read_map(built / "map.gpkg"), read_map(out)
    pairs = match_points(after.points_m, before.points_m, 0.5)
    assert len(pairs) >= 0.9 * len(before)
    assert after.observations[pairs[:, 0]].sum() > 1.5 * before.observations[pairs[:, 1]].sum()


def test_what_does_not_go_together_is_one_line(
    built: Path, sim: Simulated, capsys: pytest.CaptureFixture[str]
) -> None:
    taxi, out = str(built / "taxi"), str(built / "x.gpkg")
    surveyed = write_simulated(built / "surveyed", sim, reference=False)
    shutil.copy(built / "p" / "taxi.csv", surveyed / "reference.csv")
    assert run(["map", str(surveyed), "--out", out, "--poses", str(built / "q")]) == 2
    assert "--poses writes what --slam solves for" in capsys.readouterr().err
    assert run(["map", taxi, "--out", out, "--poses", taxi]) == 2
    assert not (built / "x.gpkg").exists()


def test_drives_names_become_names_of_files() -> None:
    assert file_stem("park:lap 1/2") == "park_lap 1_2"
    assert file_stem("..") == "drive"


def test_workers_condense_drives_and_the_map_is_that_of_one_worker(
    built: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    maps = []
    for workers in ("1", "2"):
        out = tmp_path / f"{workers}.gpkg"
        arguments = ["map", str(built / "taxi"), "--slam", "--workers", workers, "--out", str(out)]
        assert run([*arguments, "--poses", str(tmp_path / f"p{workers}")]) == 0
        assert not (tmp_path / f".{out.name}.checkpoints").exists()
        maps.append(read_map(out))
    np.testing.assert_array_equal(maps[0].points_m, maps[1].points_m)
    poses = [(tmp_path / f"p{workers}" / "taxi.tum").read_text() for workers in "12"]
    assert poses[0] == poses[1]
    whole = read_map(built / "map.gpkg")
    pairs = match_points(maps[0].points_m, whole.points_m, 0.5)
    assert len(pairs) >= 0.95 * len(whole)
    assert "built without reference:" in capsys.readouterr().out
