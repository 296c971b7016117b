"""What a report refuses: damaged runs, wrong options, other frames, a drive that must be wrong."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polemap.drivelog.tum import read_tum, tum_text
from polemap.tools import cli
from polemap.vehicle.trajectory import Trajectory

Maker = Callable[..., Path]


@pytest.fixture(scope="module")
def campus(make_runs: Maker, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_runs(tmp_path_factory.mktemp("campus"), runs=2)


def cut(path: Path) -> None:
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[: len(lines) // 2]))


def repeat_header(path: Path) -> None:
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join([*lines[:3], lines[0], *lines[3:]]))


def put(path: Path, stamp: str) -> None:
    """Another stamp in line 3."""
    lines = path.read_text().splitlines(keepends=True)
    lines[2] = f"{stamp},{lines[2].partition(',')[2]}"
    path.write_text("".join(lines))


def figures(run: Path, **changed: Any) -> None:
    path = run / "metrics.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changed}))


def refuse(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert cli.run(["report", *arguments]) == cli.USER_ERROR
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    return lines[0]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda run: shutil.rmtree(run), "no such run folder"),
        (lambda run: [path.unlink() for path in run.iterdir()], "is not a run folder"),
        (lambda run: (run / "pf.tum").unlink(), "pf.tum: no such trajectory"),
        (lambda run: (run / "kf.tum").write_text("1 2 3\n"), "kf.tum:1: 3 numbers"),
        (lambda run: (run / "kf.tum").write_text("1 2 3 0 0 0 0 one\n"), "kf.tum:1: '1 2 3"),
        (lambda run: (run / "kf.tum").write_text("1 nan 3 0 0 0 0 1\n"), "pose 1 has x = nan"),
        (lambda run: (run / "kf.tum").write_text("# nothing\n"), "holds no pose"),
        (lambda run: (run / "kf.tum").write_bytes(b"\x89PNG\xff\xfe"), "kf.tum"),
        (lambda run: (run / "metrics.json").write_text("{"), "metrics.json: not JSON"),
        (lambda run: (run / "metrics.json").write_text("[]"), "expected an object"),
        (lambda run: (run / "config.yaml").write_text("a: [b"), "config.yaml: not YAML"),
        (lambda run: (run / "config.yaml").write_text("5"), "expected settings"),
        (lambda run: (run / "config.yaml").write_text("seed: x"), "not a whole number"),
        (lambda run: (run / "health.csv").write_text(""), "is empty"),
        (lambda run: (run / "health.csv").write_text("a,b\n1\n"), "health.csv:2: 1 cells"),
        (lambda run: cut(run / "health.csv"), "rows, and pf.tum beside it"),
        (lambda run: cut(run / "pf.tum"), "health.csv: has"),
        (lambda run: repeat_header(run / "health.csv"), "column stamp_s: 'stamp_s' is no number"),
        (lambda run: put(run / "health.csv", "1e308"), "health.csv:3: stamp_s is 1e+308"),
        (lambda run: put(run / "health.csv", "7"), "health.csv:3: stamp_s is 7.000, that of the"),
        (lambda run: figures(run, timing_ms=3), "timing_ms: expected an object, found int"),
        (lambda run: figures(run, timing_ms={"a": {"p95": "x"}}), "timing_ms.a.p95 is 'x'"),
        (lambda run: figures(run, reinitializations="many"), "reinitializations is 'many'"),
        (lambda run: figures(run, gate_rejections=True), "gate_rejections is 'True'"),
        (lambda run: figures(run, late_dropped=-1), "a count below zero"),
        (lambda run: figures(run, real_time_factor=1e308), "real_time_factor is '1e+308'"),
        (lambda run: figures(run, real_time_factor=float("nan")), "real_time_factor is 'nan'"),
        (lambda run: figures(run, kf={"lateral_rmse_m": []}), "kf.lateral_rmse_m is '[]'"),
        (lambda run: figures(run, pf=[1]), "pf: expected an object, found list"),
        (lambda run: figures(run, verdict={"healthy_share": "all"}), "verdict.healthy_share"),
    ],
)  # fmt: skip
def test_damaged_run_folders(
    campus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    damage: Callable[[Path], Any], message: str,
) -> None:  # fmt: skip
    run = tmp_path / "run"
    shutil.copytree(campus / "000", run)
    damage(run)
    out = tmp_path / "out"
    assert message in refuse([str(run), "--out", str(out)], capsys)
    assert not out.exists()


@pytest.mark.parametrize(
    ("option", "message"),
    [
        (["--exclude", "9:5"], "the end must lie behind"),
        (["--exclude", "nowhere/1:2"], "no route is called 'nowhere'"),
        (["--add", "x"], "expected NAME=FILE.tum"),
        (["--add", "kf=a.tum"], "the name 'kf' is taken"),
        (["--add", "mine=missing.tum"], "no such trajectory"),
        (["--sweep", "particles"], "expected NAME=VALUE"),
        (["--sweep", "particles=10,10"], "given twice"),
        (["--sweep", "frame_rate=fast"], "frame rate 'fast'"),
        (["--sweep", "localize.magic=1"], "magic"),
        (["--sweep", "particles=-5"], "particles"),
    ],
)
def test_wrong_options(
    campus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    option: list[str], message: str,
) -> None:  # fmt: skip
    assert message in refuse([str(campus), "--out", str(tmp_path / "out"), *option], capsys)


def test_added_trajectory_of_another_clock(
    campus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    late = tmp_path / "late.tum"
    late.write_text("1e9 0 0 0 0 0 0 1\n1000000001 1 0 0 0 0 0 1\n")
    out = tmp_path / "out"
    arguments = [str(campus), "--add", f"late={late}", "--out", str(out)]
    assert "share no time" in refuse(arguments, capsys)


def test_added_trajectory_of_another_origin(
    campus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kf = read_tum(campus / "000" / "kf.tum")
    far = tmp_path / "far.tum"
    far.write_text(tum_text(Trajectory(kf.stamp_s, kf.poses + np.array([4e5, 0.0, 0.0]))))
    arguments = [str(campus), "--add", f"far={far}", "--out", str(tmp_path / "out")]
    assert "km from the runs; give it in their frame, or --align" in refuse(arguments, capsys)


def test_a_drive_that_cannot_be_right_is_refused_unless_forced(
    make_runs: Maker, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = make_runs(tmp_path, runs=1, laps=3)
    path = tmp_path / "synthetic_drive" / "reference.csv"
    head, *rows = path.read_text().splitlines()
    at = head.split(",").index("yaw_rad")
    table = [row.split(",") for row in rows]
    turned = [[*row[:at], str(3.1 + float(row[at])), *row[at + 1 :]] for row in table]
    path.write_text("\n".join([head, *(",".join(row) for row in turned)]) + "\n")
    out = tmp_path / "out"
    assert "yaw" in refuse([str(run), "--out", str(out)], capsys)
    assert not out.exists()
    assert cli.run(["report", str(run), "--out", str(out), "--force"]) == cli.GOOD
    assert "error: " in capsys.readouterr().err
