"""`polemap study`: names, tables, files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from polemap.electric.studies.study import Curve, Line, Panel, Study
from polemap.tools import cli
from polemap.tools.study import table, write_study

STUDY = Study(
    "X",
    "a title",
    (Line("name", "1.0", "2.0", "best"),),
    (),
    ("a remark",),
    {"never": float("inf"), "once": 1.5},
    (Panel("m", (Curve("a", np.arange(3.0), np.arange(3.0)),), (1.0,)),),
    ("ours", "expected", "paper"),
)


def test_table_has_the_studys_own_headings() -> None:
    text = table(STUDY, 3)
    assert text.splitlines()[0] == "X: a title (3 seeds)"
    assert text.splitlines()[1].split() == ["ours", "expected", "paper"]
    assert "  - a remark" in text


def test_figures_are_json_and_the_picture_is_there(tmp_path: Path) -> None:
    write_study(STUDY, tmp_path)
    assert json.loads((tmp_path / "X.json").read_text("utf-8")) == {"never": None, "once": 1.5}
    assert (tmp_path / "X.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["frobnicate"], "no study frobnicate; there are W12, W14, W13, N13, N13-slip"),
        (["W14", "--estimator", "clones"], "W14 is no closed loop"),
        (["n13_cornering", "--estimator", "clones"], "estimator clones cannot serve here"),
        (["N13-slip", "--vehicle", "passat"], "passat: rear_track_m is not known"),
    ],
)
def test_what_the_user_can_mend_is_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(["study", *arguments]) == cli.USER_ERROR
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_a_closed_loop_runs_behind_one_estimator(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "margins"
    arguments = ["study", "w14-margins", "--estimator", "bicycle", "--no-page", "--out", str(out)]
    assert cli.run(arguments) == cli.GOOD
    assert "estimator in the loop: bicycle" in capsys.readouterr().out
    figures = json.loads((out / "W14-margins.json").read_text("utf-8"))
    assert figures["loop_gap_db"] >= 20.0
