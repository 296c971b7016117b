"""The pages of `estimate` and `study`: what stands on them, and what happens without the extra."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from polemap.electric.config import EstimatorConfig
from polemap.electric.signals import Played, SignalLog
from polemap.electric.studies.scenes import Scene, drive_with_camera
from polemap.electric.studies.study import Curve, Line, Panel, Study
from polemap.electric.watched import Fault, Innovations, Record
from polemap.tools import option_types
from polemap.tools.cli import run
from polemap.tools.report.signals_page import estimate_section, render_signals
from polemap.tools.report.study_page import study_section
from polemap.vehicle.io import load_car


@pytest.fixture
def log(tmp_path: Path) -> Path:
    config = EstimatorConfig(step_s=0.005)
    scene = Scene(7.0, 4.0, 0.05, 0.5, model_noise=False)
    drive = drive_with_camera(load_car("coms"), scene, config, np.random.default_rng(0))
    table = pd.DataFrame({"stamp_s": drive.log.stamp_s, **drive.log.columns})
    table["sideslip_rad"] = drive.truth[:, 0]
    table.to_csv(tmp_path / "log.csv", index=False)
    return tmp_path / "log.csv"


def estimate(log: Path, *more: str) -> int:
    out = str(log.parent / "out.csv")
    command = ["estimate", str(log), "--vehicle", "coms", "--estimator", "clones", "--out", out]
    return run([*command, *more])


def test_estimate_writes_a_page_beside_its_csv(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert estimate(log) == 0
    page = (log.parent / "out.html").read_text()
    assert "out.html" in capsys.readouterr().err
    for text in ("Estimate of clones", "side-slip, RMSE", "Innovations", "Faults found", "Inputs"):
        assert text in page
    assert page.count("chart wide") == page.count("chart narrow") >= 7
    assert "http://" not in page.replace("http://www.w3.org", "")  # nothing from elsewhere


def test_the_page_of_nonlinear_shows_bank_grade_and_nees(log: Path) -> None:
    assert estimate(log, "--estimator", "nonlinear") == 0
    page = (log.parent / "out.html").read_text()
    for text in ("Bank of the road", "Grade of the road", "side-slip, NEES", "within two stated"):
        assert text in page


def test_no_page_where_none_is_wanted_or_can_be_drawn(
    log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert estimate(log, "--no-page") == 0
    assert not (log.parent / "out.html").exists()
    plain = (log.parent / "out.csv").read_bytes()
    capsys.readouterr()

    def missing(module: str) -> None:
        raise option_types.MissingExtraError(f"{module} is missing: install polemap[report]")

    monkeypatch.setattr(option_types, "check_installed", missing)
    assert estimate(log) == 0
    said = capsys.readouterr().err
    assert "note: no page: matplotlib is missing" in said
    assert not (log.parent / "out.html").exists()
    assert (log.parent / "out.csv").read_bytes() == plain


def test_a_page_shows_faults_and_escapes_what_comes_from_logs() -> None:
    stamps = np.array([0.0, 0.1, 0.2, 8.0, 8.1])
    signals = SignalLog(stamps, {"yaw_rate_radps": np.zeros(5)})
    played = Played(stamps, ("sideslip_rad",), np.zeros((5, 1)), np.full((5, 1), 0.01))
    record = Record({"heading_rad": Innovations([0.1], [0.02], [0.01])})
    record.faults.append(Fault("camera", "<b>wild</b>", 0.1, 0.2, 2))
    section = estimate_section("own", signals, played, None, record, {})
    page = render_signals("own", [section])
    assert "&lt;b&gt;wild" in page
    assert "<b>wild" not in page
    assert "no row" in page  # the gap of the log
    many = Record({}, [Fault("gps", "late", float(k), k + 0.1, 1) for k in range(300)])
    section = estimate_section("own", signals, played, None, many, {})
    assert "The first 200 of 301" in section.tables[0].note


def test_a_study_is_a_table_and_its_curves() -> None:
    stamps = np.linspace(0.0, 1.0, 50)
    curves = (Curve("truth", stamps, stamps), Curve("one", stamps, stamps + 0.1))
    lines = (Line("ratio", "0.5", "0.6", "better"),)
    study = Study("S1", "Some study", lines, curves, ("A remark.",), {})
    bode = Panel("gain, dB", (Curve("loop", stamps + 0.1, stamps),), (0.0,), "Hz", log_x=True)
    other = Study("S2", "Bode", lines, (), (), {}, (bode,))
    page = render_signals("both", [study_section(study, 1), study_section(other, 3)])
    for text in ("S1: Some study", "1 seed", "3 seeds", "A remark.", "side-slip error", "better"):
        assert text in page
    assert page.count("chart wide") == page.count("chart narrow") == 3
    assert study_section(Study("S3", "bare", lines, (), (), {}), 1).pictures == ()


def test_study_writes_its_page_where_it_is_run_or_into_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["study", "W14-margins", "--estimator", "single_rate"]) == 0
    assert "Nyquist" in (tmp_path / "study_W14-margins.html").read_text()
    more = ["--estimator", "single_rate", "--no-page"]
    assert run(["study", "W14-margins", "--out", str(tmp_path / "out"), *more]) == 0
    assert not (tmp_path / "out" / "study.html").exists()
