"""Sweeps replay the recording under other settings, once for each value and seed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from polemap.drivelog.errors import ConfigError
from polemap.tools import cli
from polemap.tools.report.sweep_spec import parse_sweep, parse_sweeps, settings_of

Maker = Callable[..., Path]


@pytest.mark.slow
def test_sweep_resumes_and_does_not_depend_on_the_workers(
    make_sensor_drive: Maker, tmp_path: Path
) -> None:
    drive = make_sensor_drive(tmp_path / "ring")
    run, out = tmp_path / "run", tmp_path / "out"
    few = ["--set", "localize.particles=60"]
    localize = ["localize", str(drive), "--map", str(tmp_path / "ring.csv"), "--out", str(run)]
    assert cli.run([*localize, *few]) == cli.GOOD
    report = ["report", str(run), "--out", str(out), "--sweep-runs", "1", "--seed", "5"]
    report += ["--sweep", "frame_rate=full,half"]
    assert cli.run([*report, "--workers", "1"]) == cli.GOOD
    first = json.loads((out / "report.json").read_text())["sweeps"]["frame_rate"]
    kept = {path: path.stat().st_mtime_ns for path in (out / "cache").iterdir()}
    assert len(kept) == 2
    lost = min(kept)
    lost.unlink()
    del kept[lost]
    assert cli.run([*report, "--sweep", "particles=60,90", "--workers", "2"]) == cli.GOOD
    again = {path: path.stat().st_mtime_ns for path in (out / "cache").iterdir()}
    # 60 particles at the full rate are the run that is there already; 90 are new.
    assert len(again) == 3
    assert lost in again
    assert kept.items() <= again.items()
    swept = json.loads((out / "report.json").read_text())["sweeps"]
    assert swept["frame_rate"] == first
    full, half = swept["frame_rate"]["ring"]
    sixty, ninety = swept["particles"]["ring"]
    assert full["frame_rate_hz"] == pytest.approx(2.0 * half["frame_rate_hz"]) == 10.0
    assert full["kf_m"] == sixty["kf_m"]
    assert ninety["kf_m"] != sixty["kf_m"]
    assert all(0.02 < one["kf_m"] < 0.5 for one in (full, half, sixty, ninety))
    assert (out / "tables" / "sweep-frame-rate.csv").is_file()
    assert (out / "pictures" / "sweep-particles-0.svg").is_file()


def test_settings_of_a_run_with_changes() -> None:
    sweep = parse_sweep("localize.p_detection=0.5,0.9")
    config = {"settings": {"localize": {"particles": 77}, "simulate": {"gone": 1}}}
    settings = settings_of(config, sweep.values[1].settings)
    assert settings.localize.particles == 77
    assert settings.localize.p_detection == 0.9
    assert [value.number for value in sweep.values] == [0.5, 0.9]


def test_frame_rates() -> None:
    sweep = parse_sweep("frame_rate=full,half,1/5")
    assert [value.every for value in sweep.values] == [1, 2, 5]


def test_two_sweeps_of_one_quantity_are_refused() -> None:
    with pytest.raises(ConfigError, match="--sweep particles is given twice"):
        parse_sweeps(["particles=50,100", "frame_rate=full,half", "particles=200"])
