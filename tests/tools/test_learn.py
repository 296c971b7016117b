"""`polemap localize --learn`: what a drive saw goes into a copy of the map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from polemap.build.map_diff import match_points
from polemap.map.io import read_map, write_map
from polemap.map.pole_map import PoleMap
from polemap.tools.cli import run
from tests.polemap.build.slam.loops import Simulated, beside, block, simulated, write_simulated

pytest.importorskip("gtsam")


@pytest.fixture(scope="module")
def sim() -> Simulated:
    rng = np.random.default_rng(301)
    poses = block(1.3)
    return simulated(poses, beside(poses[:330], 6.0, rng), rng)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory, sim: Simulated) -> Path:
    """A drive round a block, and a map of its near half."""
    folder = tmp_path_factory.mktemp("learn")
    write_simulated(folder / "taxi", sim)
    near = sim.poles.points_m[:, 0] < 40.0
    points = sim.poles.points_m[near]
    n = len(points)
    half = PoleMap(
        frame=sim.drive.frame,
        ids=np.arange(1, n + 1),
        points_m=points,
        covariance_m2=np.tile(0.03**2 * np.eye(2), (n, 1, 1)),
        width_m=sim.poles.width_m[near],
        height_m=np.full(n, np.nan),
        observations=np.full(n, 20),
        drives=np.full(n, 1),
        existence=np.full(n, 0.95),
    )
    write_map(half, folder / "half.gpkg")
    return folder


def test_the_other_half_of_a_block_is_learnt(
    place: Path, sim: Simulated, capsys: pytest.CaptureFixture[str]
) -> None:
    out = place / "whole.gpkg"
    arguments = ["localize", str(place / "taxi"), "--map", str(place / "half.gpkg")]
    before = (place / "half.gpkg").read_bytes()
    assert run([*arguments, "--out", str(place / "run"), "--learn", str(out)]) == 0
    assert "of them new, known in the map to" in capsys.readouterr().out
    assert (place / "half.gpkg").read_bytes() == before
    old, learnt = read_map(place / "half.gpkg"), read_map(out)
    assert np.isin(old.ids, learnt.ids).mean() > 0.9
    new = ~np.isin(learnt.ids, old.ids)
    far = sim.poles.points_m[:, 0] >= 40.0
    truth = sim.poles.points_m[far]
    pairs = match_points(learnt.points_m[new], truth, 1.0)
    # what was seen too seldom waits in the map, as with any building
    assert len(pairs) >= 0.7 * len(truth)
    assert len(pairs) >= 0.9 * np.count_nonzero(new)
    off = learnt.points_m[new][pairs[:, 0]] - truth[pairs[:, 1]]
    assert np.median(np.hypot(*off.T)) < 0.2
    # what it says of itself in the map holds
    columns = ("absolute_var_east_m2", "absolute_cov_east_north_m2", "absolute_var_north_m2")
    east, cross, north = (learnt.extra[name][new][pairs[:, 0]] for name in columns)
    spread = np.stack([np.stack([east, cross], -1), np.stack([cross, north], -1)], -2)
    known = np.isfinite(east)
    assert known.mean() > 0.8
    nees = np.einsum("ni,nij,nj->n", off[known], np.linalg.inv(spread[known]), off[known])
    # poles share the error of the way, so that they count for a few
    assert nees.mean() / 2.0 < 3.0


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--learn", "half.gpkg"], "that is the map itself"),
        (["--learn", "x.gpkg", "--runs", "2"], "--learn takes one run"),
        (["--learn", "x.docx"], "a map is written as one of"),
    ],
)
def test_what_cannot_be_learnt_is_one_line(
    place: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    more: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(place)
    assert run(["localize", "taxi", "--map", "half.gpkg", "--out", "r", *more]) == 2
    assert said in capsys.readouterr().err


def test_learning_needs_a_map_of_one_file(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(place)
    assert run(["localize", "taxi", "--without-poles", "--out", "r", "--learn", "x.gpkg"]) == 2
    assert "give --map MAP" in capsys.readouterr().err
    (place / "tiles").mkdir()
    assert run(["localize", "taxi", "--map", "tiles", "--out", "r", "--learn", "x.gpkg"]) == 2
    assert "adds to a map of one file" in capsys.readouterr().err
