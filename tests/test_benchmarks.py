"""The harness of the benchmarks: names by room, fair turns, figures, and a file that is whole."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.__main__ import main
from benchmarks.harness import FOLDER, compared, interleaved, modules, summary, write_results


def test_every_benchmark_stands_in_a_room() -> None:
    rooms = {path.name for path in FOLDER.iterdir() if (path / "__init__.py").is_file()}
    assert rooms - {"campaign", "departures", "figures"} <= {
        path.name for path in FOLDER.parent.iterdir() if path.is_dir()
    }
    assert {name.split(".")[0] for name in modules()} <= rooms
    assert {"stereo.speed", "localize.output_filter", "polemap.map_queries"} <= set(modules())


def test_an_unknown_benchmark_is_named_with_those_there_are(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["stereo.sped"]) == 2
    assert "no benchmark stereo.sped; there are: " in capsys.readouterr().err


def test_work_takes_turns_and_warm_ups_do_not_count() -> None:
    order: list[str] = []
    work = {"a": lambda: order.append("a"), "b": lambda: order.append("b")}
    times = interleaved(work, 3, warm_up=1)
    assert "".join(order) == "abababab"
    assert [len(values) for values in times.values()] == [3, 3]


def test_figures_are_milliseconds_and_ratios() -> None:
    assert summary([0.001, 0.003, 0.002], 99)["median_ms"] == pytest.approx(2.0)
    assert set(summary([1.0], 99)) == {"median_ms", "p95_ms", "p99_ms"}
    table = compared({"slow": [0.004, 0.004], "fast": [0.002, 0.002]}, "fast")
    assert table["slow"]["ratio_to_fast"] == pytest.approx(2.0)


def test_results_are_written_whole(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    write_results(path, {"a": {"median_ms": 1.0}})
    assert json.loads(path.read_text()) == {"a": {"median_ms": 1.0}}
    assert [entry.name for entry in tmp_path.iterdir()] == ["results.json"]
