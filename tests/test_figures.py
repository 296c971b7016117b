"""The paper's figures and the worlds that are set aside: what is run, measured and printed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.evaluate.report_routes import short_world
from benchmarks.figures.__main__ import _KEY, wanted
from benchmarks.figures.laps import CONFIGURATIONS, EASY, HARD, Laps, drive_of, laps_of
from benchmarks.figures.measure import EVERY, PARTICLES, scans_of, track_figures
from benchmarks.figures.plots import sweep
from benchmarks.figures.street import street_extract
from benchmarks.figures.tables import sweep_table
from benchmarks.harness import append_row, rows_in
from benchmarks.localize import set_aside
from polemap.localize.config import LocalizeConfig
from polemap.settings import load_settings
from polemap.tools.background import read_background
from polemap.vehicle.trajectory import Trajectory


@pytest.fixture(scope="module")
def laps(tmp_path_factory: pytest.TempPathFactory) -> Laps:
    folder = tmp_path_factory.mktemp("figures")
    drives = [drive_of("park_loop", condition, 2, folder) for condition in (EASY, HARD)]
    return laps_of("park_loop", HARD, 2, CONFIGURATIONS["ours"](), *drives)


def test_every_run_is_asked_for_once_a_seed_and_a_second_seed_adds() -> None:
    one, two = (list(wanted(["park_loop", "suburb"], n, n)) for n in (1, 2))
    assert len({key for key in two if key[-1] == 1}) == len(set(one))
    assert set(one) < set(two)
    hard = [key for key in one if key[1] == HARD and key[2] == "ours"]
    assert {key[3] for key in hard} == set(EVERY)
    assert {key[4] for key in hard} == set(PARTICLES)
    assert all(key[0] == "park_loop" for key in hard)


def test_the_configurations_are_ours_and_the_printed_one() -> None:
    printed = load_settings(Path("papers/s16.yaml"))
    assert CONFIGURATIONS["as printed"]().localize == printed.localize
    assert CONFIGURATIONS["ours"]().localize == LocalizeConfig()


def test_truth_has_no_error_and_the_reference_drifts(laps: Laps) -> None:
    true, drifting = (track_figures(laps, track) for track in (laps.truth, laps.reference))
    assert true["lateral_m"] == pytest.approx(0.0, abs=1e-9)
    assert true["missing"] == 0.0
    # the driver's own wander, and far above it the drift
    assert 0.02 < true["repeatability_m"] < 0.4
    assert drifting["repeatability_m"] > true["repeatability_m"]
    assert drifting["lateral_m"] > 0.1


def test_a_track_far_away_is_lost_and_missing(laps: Laps) -> None:
    away = Trajectory(laps.truth.stamp_s, laps.truth.poses + np.array([40.0, 0.0, 0.0]))
    found = track_figures(laps, away)
    assert found["lost"] == 1.0
    assert found["missing"] > 0.4


def test_a_lower_rate_looks_at_fewer_frames(laps: Laps) -> None:
    settings = CONFIGURATIONS["ours"]()
    assert len(scans_of(laps, settings, 10)) == -(-len(laps.drive.scans) // 10)


def row(**changed: Any) -> dict[str, Any]:
    track = {"repeatability_m": 0.1, "missing": 0.0, "lateral_m": 0.03, "along_m": 0.1, "lost": 0.5}
    return {"route": "park_loop", "condition": HARD, "configuration": "ours", "every": 1,
            "particles": 1000, "seed": 0, "pf": track, "kf": track,
            "restarts": {"spread": 2}} | changed  # fmt: skip


def test_restarts_are_told_by_cause_and_failures_left_out() -> None:
    rows = [row(), row(seed=1, restarts={"poles": 1}), row(seed=2) | {"failed": "no pose"}]
    lines = list(sweep_table(rows, "park_loop", "frames a second", "every", EVERY))
    (line,) = lines[2:]
    assert line.startswith("| 22.0 | harder | ours | 2 | 0.100, 0.100 | 0.030, 0.030 m | 50, 50 %")
    assert line.endswith("| poles 0.5, spread 1.0 |")


def test_a_sweep_is_drawn_from_what_there_is() -> None:
    picture = sweep([row(), row(every=10)], "park_loop", "figure_6", "every",
                    [(1, 22.0), (10, 2.2)], "frames a second")  # fmt: skip
    assert "output over 2 m off" in picture.svg


def test_the_street_of_a_world_is_an_extract(laps: Laps, tmp_path: Path) -> None:
    path = street_extract(short_world("park_loop"), laps.drive.frame, tmp_path / "a.osm")
    found = read_background(path, laps.drive.frame, laps.pole_map.points_m)
    assert len(found.lines["road"]) == 1
    gap = np.hypot(*(found.lines["road"][0][:, None] - laps.truth.poses[::50, :2]).T)
    # the car keeps to its side of the road
    assert gap.min(axis=1).max() < 6.0
    assert found.areas["building"]


def test_a_cut_line_is_made_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_text(json.dumps(row()) + "\n" + json.dumps(row(seed=1))[:40])
    assert [key[-1] for key in rows_in(path, *_KEY)] == [0]
    # the next row does not hang on what was cut off
    append_row(path, {**next(iter(rows_in(path, *_KEY).values())), "seed": 7})
    assert [key[-1] for key in rows_in(path, *_KEY)] == [0, 7]
    assert "a line that is no row is left out" in capsys.readouterr().err


def test_worlds_set_aside() -> None:
    worlds = set_aside.set_aside()
    assert len(worlds) == len(set(worlds)) >= 12
    # settings were chosen on small numbers
    assert min(worlds) > 1000


def test_the_table_of_worlds_counts_the_consistent() -> None:
    rows = [
        {"route": "suburb", "world": n, "pictures": False,
         "pf": {"lateral_m": 0.01 * n, "along_m": 0.1, "nees": nees},
         "kf": {"lateral_m": 0.02, "along_m": 0.1, "nees": 1.0}}
        for n, nees in ((1, 0.1), (2, 0.2), (3, 0.3))
    ]  # fmt: skip
    (text,) = set_aside.tables([*rows, rows[0] | {"failed": "no pose", "world": 4}])
    line = next(line for line in text.splitlines() if line.startswith("| suburb | 3 | particle"))
    assert "0.020, 0.010, 0.030 m" in line
    assert line.endswith("| 0.20, 0.10, 0.30 | 0 of 3, scaled 2 |")
