"""The template of docs/plugins.md, installed by pip, serves the command; broken ones are told."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.drivelog.drives import picture

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "plugins.md").read_text(encoding="utf-8")
LOG = "stamp_s,yaw_rate_radps,road_wheel_angle_rad,vx_mps\n" + "".join(
    f"{0.01 * i:.2f},0.0,0.0,10.0\n" for i in range(300)
)


def install(package: Path, target: Path) -> None:
    words = [sys.executable, "-m", "pip", "install", "--quiet", "--no-build-isolation", "--no-deps",
             "--no-index", "--target", str(target), str(package)]  # fmt: skip
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the template of the docs and a broken package are installed."""
    place = tmp_path_factory.mktemp("plugins")
    (place / "yard").mkdir()
    for kind, name in (("toml", "pyproject.toml"), ("python", "polemap_yard.py")):
        found = re.search(rf"```{kind}\n# {re.escape(name)}\n(.*?)```", PAGE, re.DOTALL)
        assert found is not None, name
        (place / "yard" / name).write_text(found[1], encoding="utf-8")
    install(place / "yard", place / "site")
    # as pip leaves it: a package with entry points to what cannot be imported, or is no such thing
    info = place / "site" / "polemap_broken-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: polemap-broken\nVersion: 1\n")
    (info / "entry_points.txt").write_text(
        "[polemap.readers]\nbroken = polemap_broken:reader\nfolder = polemap_yard:reader\n"
        "empty = polemap_broken_not:reader\nfails = polemap_fails:reader\n"
        "[polemap.matchers]\nbroken = polemap_broken:matcher\nno_matcher = builtins:dict\n"
        "[polemap.estimators]\nbroken = polemap_broken:estimator\nno_entry = builtins:len\n"
    )
    (place / "site" / "polemap_broken.py").write_text("raise SystemExit('no licence\\nhere')\n")
    (place / "site" / "polemap_fails.py").write_text(
        "class R:\n    name = 'fails'\n    def can_read(self, path):\n"
        "        return path.nonsense\n    def read(self, path, *, seed):\n"
        "        pass\nreader = R()\n"
    )
    return place / "site"


def polemap(target: Path, *words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "polemap", *map(str, words)],
        env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{target}"},
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_reader_and_broken_ones_beside_it(target: Path, tmp_path: Path) -> None:
    lines = [f"{0.1 * i:.1f} 1.0 0.0" for i in range(100)]
    (tmp_path / "monday.yard").write_text("\n".join(lines))
    done = polemap(target, "info", tmp_path / "monday.yard")
    assert done.returncode == 0, done.stderr
    assert "drive      monday" in done.stdout
    notes = done.stderr.splitlines()
    assert all(line.startswith("polemap: note: ") for line in notes)
    for part in (
        "plug-in 'broken' of package polemap-broken (polemap.readers) cannot be loaded "
        "(SystemExit: no licence here)",
        "plug-in 'empty' of package polemap-broken (polemap.readers) cannot be loaded "
        "(ModuleNotFoundError",
        "plug-in 'folder' of package polemap-broken (polemap.readers) is called as one of "
        "polemap's own",
        "reader 'fails' fails at",
    ):
        assert sum(part in line for line in notes) == 1, (part, notes)
    assert len(notes) == 4
    (tmp_path / "bad.yard").write_text("one two three")
    done = polemap(target, "info", tmp_path / "bad.yard")
    assert done.returncode == 2
    assert "a line has stamp, speed and yaw rate" in done.stderr


def test_a_matcher(target: Path, tmp_path: Path) -> None:
    for side in ("left", "right"):
        cv2.imwrite(str(tmp_path / f"{side}.png"), np.tile(picture(1), (4, 6)))
    words = ["disparity", tmp_path / "left.png", tmp_path / "right.png", "--out",
             tmp_path / "d.png", "--matcher"]  # fmt: skip
    done = polemap(target, *words, "yard_flat")
    assert done.returncode == 0, done.stderr
    disparity = cv2.imread(str(tmp_path / "d.png"), cv2.IMREAD_UNCHANGED)
    assert disparity is not None
    assert set(np.unique(disparity)) == {8 * 256}
    for name, part in (
        (
            "broken",
            "plug-in 'broken' of package polemap-broken (polemap.matchers) cannot be loaded",
        ),
        ("no_matcher", "matcher plug-in no_matcher fails"),
    ):
        done = polemap(target, *words, name)
        assert done.returncode == 2, done.stderr
        assert part in done.stderr
        assert done.stderr.count("\n") == 1


def test_an_estimator(target: Path, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(LOG)
    words = ["estimate", tmp_path / "log.csv", "--vehicle", "passat", "--out", tmp_path / "e.csv",
             "--no-page", "--estimator"]  # fmt: skip
    done = polemap(target, *words, "yard_still")
    assert done.returncode == 0, done.stderr
    first = (tmp_path / "e.csv").read_text().splitlines()[0]
    assert first == "stamp_s,sideslip_rad,sideslip_sd_rad,yaw_rate_radps,yaw_rate_sd_radps"
    assert "no_entry" in done.stderr
    assert "docs/plugins.md has a template" in done.stderr
    done = polemap(target, "estimate", "--list")
    assert "never slips" in done.stdout
    assert json.dumps("bicycle")[1:-1] in done.stdout
