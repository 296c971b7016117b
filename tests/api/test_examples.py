"""The example programs of the docs, run as they stand, one after the other."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from polemap.map.io import read_map

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "docs" / "examples"
# in the order in which they build on one another
IN_ORDER = ("poles_in_a_pair", "map_from_a_drive", "localize_and_plot", "live")


@pytest.fixture(scope="module")
def said(loop: Path) -> dict[str, str]:
    """What each program printed."""
    lines = {}
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    for name in IN_ORDER:
        done = subprocess.run(
            [sys.executable, EXAMPLES / f"{name}.py"],
            cwd=loop,
            env={**os.environ, "MPLBACKEND": "Agg", "PYTHONPATH": path},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, f"{name}: {done.stderr}"
        lines[name] = done.stdout
    return lines


def test_no_program_is_left_out() -> None:
    assert sorted(IN_ORDER) == sorted(path.stem for path in EXAMPLES.glob("*.py"))


@pytest.mark.parametrize("name", IN_ORDER)
def test_a_program_needs_one_import_and_few_lines(name: str) -> None:
    text = (EXAMPLES / f"{name}.py").read_text(encoding="utf-8")
    assert re.findall(r"^(?:import|from) polemap.*$", text, re.MULTILINE) == ["import polemap"]
    assert len([line for line in text.splitlines() if line.strip()]) <= 24


@pytest.mark.slow
def test_poles_in_a_pair(said: dict[str, str], loop: Path) -> None:
    assert "width_m" in said["poles_in_a_pair"] or "x_m" in said["poles_in_a_pair"]
    assert (loop / "poles.png").stat().st_size > 10_000


@pytest.mark.slow
def test_map_from_a_drive(said: dict[str, str], loop: Path) -> None:
    count = int(said["map_from_a_drive"].split()[0])
    assert count == len(read_map(loop / "campus.gpkg")) >= 5
    assert (loop / "map.png").is_file()


@pytest.mark.slow
def test_localize_and_plot(said: dict[str, str], loop: Path) -> None:
    found = re.match(r"lateral ([\d.]+) m", said["localize_and_plot"])
    assert found
    assert float(found[1]) < 0.5
    assert (loop / "localized.png").is_file()


@pytest.mark.slow
def test_live(said: dict[str, str]) -> None:
    lines = said["live"].splitlines()
    assert len(lines) > 5
    assert lines[-1].startswith("{'")


def test_the_documentation_shows_the_live_program() -> None:
    text = (ROOT / "docs" / "live.md").read_text(encoding="utf-8")
    assert (EXAMPLES / "live.py").read_text(encoding="utf-8").strip() in text
