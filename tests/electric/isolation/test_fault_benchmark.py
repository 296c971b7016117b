"""The faults' benchmark goes on where it was stopped, and its tables say what the rows say."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.electric import faults
from benchmarks.electric.fault_tables import Row, tables


def peak(seed: int, alone: float, isolated: float, after_s: float | None) -> Row:
    return {"table": "peaks", "of": "gyro", "fault": "step", "seed": seed, "after_s": after_s,
            "deg": {"bicycle": [alone, isolated]}, "wrong": [], "pairs": []}  # fmt: skip


def test_tables_give_medians_the_worst_case_and_who_was_found() -> None:
    text = tables([peak(0, 2.0, 0.2, 0.1), peak(1, 4.0, 0.4, None), peak(2, 3.0, 3.6, 0.3)])
    assert "| `bicycle` | 3.0 → 0.4 (3.6) |" in text
    assert "| found, of | 2 of 3 |" in text
    assert "| after, s | 0.2 (0.3) |" in text
    assert "better in 66.7%" in text
    assert "worse in 33.3%, by 0.6 degrees at most" in text


def test_alarms_are_counted_by_the_hour() -> None:
    rows = [
        {"table": "alarms", "of": "town", "fault": "15", "seed": s, "accused": a, "withheld": []}
        for s, a in ((0, []), (1, ["gyro"]))
    ]
    assert tables(rows).startswith("False alarms: 2 an hour, 0 of them withheld (2 clean drives")


def test_a_run_goes_on_where_it_was_stopped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "faults.jsonl"
    options = ["--only", "alarms", "--seeds", "1", "--hours", "0.01", "--workers", "1"]
    known = {"table": "alarms", "of": "town", "fault": "0.15", "seed": 300}
    told = {**known, "accused": ["written before"], "withheld": []}
    out.write_text(json.dumps(told) + "\n" + '{"table": "ala')
    faults.main([*options, "--out", str(out)])
    styles = [json.loads(line)["of"] for line in out.read_text().splitlines() if line[-1] == "}"]
    assert sorted(styles) == sorted(["town", "country", "motorway", "brisk"])
    assert "written before" in capsys.readouterr().out
