"""Every command of README and docs is run, in the order of its page.

The paths that a page takes for the reader's own are made here, small, and a few options make short
what would take minutes. What cannot run stands below with the reason, and then at least its help.
"""

from __future__ import annotations

import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from benchmarks.harness import modules
from polemap.simulate import drive
from polemap.simulate.scenario import Scenario
from polemap.tools import cli
from tests.docs_commands import PAGES, ROOT, commands, words_of
from tests.docs_data import REVS, STREET, Garage

# what each page takes for granted: a place and what is laid there
NEEDS: dict[str, dict[str, str]] = {
    "README.md": {
        "drives/monday": "monday", "drives/friday": "friday", "sequences": "kitti/sequences",
        "poles": "kitti/poles", "poses": "kitti/poses", "LOG": "can",
    },
    "city.md": {"drives/lap_1": "lap_1", "drives/lap_2": "lap_2"},
    "calibration.md": {"DRIVE": "monday"},
    "camera_odometry.md": {"DRIVE": "monday"},
    "drives.md": {"DRIVE": "lap_1"},
    "estimators.md": {"LOG": "estimator_log"},
    "perception.md": {"DRIVE": "monday", "MAP.geojson": "map.geojson"},
    "simulator.md": {"my_street.yaml": "my_street"},
    "start.md": {"FILE": "street_mcap", "LOG.csv": "can"},
    "stereo.md": {"DRIVE": "monday"},
    "troubleshooting.md": {"DRIVE": "monday", "MAP.gpkg": "map.gpkg"},
    "kitti.md": {"": "kitti"},
    "live.md": {
        "recording.mcap": "street_mcap", "campus.gpkg": "map.gpkg", "drives/lap_1": "lap_1",
    },
    "logs.md": {
        "can.csv": "can", "gps.nmea": "nmea", "track.gpx": "gpx", "signals.yaml": "signals",
    },
    "maps.md": {
        "drives/monday": "lap_1", "drives/tuesday": "lap_2", "drives/friday": "lap_2",
        "campus_old.gpkg": "map.gpkg",
    },
    "place.md": {"drives/lap_1": "lap_1", "drives/lap_2": "lap_2"},
    "recordings.md": {
        "monday": "bag_monday", "tuesday": "bag_friday", "drive.mcap": "drive_mcap",
    },
    "repeatability.md": {"victoria_park/drive": "lap_1", "campus/drive": "lap_1"},
    "slam.md": {
        "drives/taxi": "taxi", "drives/taxi_monday": "taxi", "drives/taxi_friday": "taxi",
        "drives/kitti": "kitti",
    },
    "viewers.md": {"drives/monday": "monday"},
}  # fmt: skip

# commands of the reader that a page speaks of as done
BEFORE = {
    "repeatability.md": [
        "polemap map campus/drive --out campus/map.gpkg",
        "polemap localize campus/drive --map campus/map.gpkg --out runs/campus --runs 2",
    ],
    "viewers.md": [
        "polemap map drives/monday --out m.gpkg",
        "polemap localize drives/monday --map m.gpkg --out runs/lap_2",
    ],
    "city.md": ["polemap map drives/lap_1 --out districts/north.gpkg"],
    "place.md": ["polemap map drives/lap_1 --out districts/north.gpkg"],
}

# what makes a command short: the first pattern that is found in it adds these words
SHORTER = (
    (r"^polemap simulate (?!.*--scans)",
     "--set simulate.camera.width_px=96 --set simulate.camera.height_px=64 "
     "--set simulate.camera.focal_px=100 --set simulate.camera.frame_rate_hz=2 "
     "--set simulate.render.workers=1"),
    (r"--runs (?:10|20)$", "--runs 2"),
    (r"--identify 150:250", "--identify 150:160"),
    (r"--sweep frame_rate", "--sweep particles=50,100"),
)  # fmt: skip

# what is not run as it stands, and why; `--help` of a verb is run, a benchmark is imported
NOT_RUN = (
    (r"^pip ", "installs from the network; CI installs before it tests"),
    (r"^make ", "the suite itself, or what it runs: `make demo` and `make site` are CI's"),
    (r"^polemap demo", "three minutes; `make demo` runs it"),
    (r"^polemap study", "ten seconds to minutes each; tests/tools/test_study.py runs studies"),
    (r"^polemap --install-completion", "writes into the shell's start-up file"),
    (r"somewhere\.yard", "needs the plug-in installed; tests/tools/test_plugins.py runs it"),
    (r"^polemap train", "minutes; tests/polemap/ trains on what it makes"),
)
# what a page calls by a word in capitals, where a file of that name cannot stand for it
MEANT = (
    ("polemap new DRIVE", "polemap new new_drive"),
    (
        "LOG --estimator NAME --vehicle CAR --out CSV",
        "LOG --estimator bicycle --vehicle 250lm --out a.csv",
    ),
    ("RUN... --out DIR", "runs/campus --out DIR"),
    (
        "--evaluate MAP [--unmapped MAP] [--pictures]",
        "--evaluate MAP.geojson --unmapped MAP.geojson --pictures",
    ),
    ("LEFT RIGHT --out", "DRIVE/left/000000.png DRIVE/right/000000.png --out"),
    ("polemap info MAP", "polemap info MAP.gpkg"),
)  # fmt: skip
# the grammar of a command whose whole example stands beside it
GRAMMAR = (
    "[,C:D]",
    "--matcher NAME",
    "--estimator NAME",
    "VERB --help",
    "--write-mapping$",
    "report --align time$",
)


def not_run(command: str) -> bool:
    return any(re.search(pattern, command) for pattern, _ in NOT_RUN)


@pytest.fixture(scope="session")
def garage(tmp_path_factory: pytest.TempPathFactory) -> Garage:
    return Garage(tmp_path_factory.mktemp("garage"))


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_verbs_and_options_exist(page: Path) -> None:
    for command in commands(page):
        words = words_of(command.replace("...", ""))
        if words[:1] != ["polemap"] or len(words) < 2 or words[1].startswith(("-", "VERB")):
            continue
        assert words[1] in cli.VERBS, command
        group: Any = get_command(cli.build_app(words[1]))
        known = {
            name
            for option in group.commands[words[1]].params
            for name in (*option.opts, *option.secondary_opts)
        }
        for word in words[2:]:
            if word.startswith("--"):
                assert word.partition("=")[0] in known | {"--help"}, command


def is_grammar(command: str) -> bool:
    return any(part in f"{command}$" for part in GRAMMAR)


def is_mention(command: str) -> bool:
    """A verb that the text speaks of, with nothing that it could be run on."""
    own = [word for word in command.split()[2:] if not word.startswith("-")]
    return len(command.split()) > 1 and not own and not command.endswith(("--list", "--help"))


def as_run(command: str) -> list[str]:
    """The words of a command with what it stands for, made short."""
    for told, meant in MEANT:
        command = command.replace(told, meant)
    words = words_of(command)[1:]
    if is_mention(command) or is_grammar(command) or not_run(command):
        return [words[0], "--help"] if words and words[0] in cli.VERBS else ["--help"]
    for pattern, shorter in SHORTER:
        if re.search(pattern, command):
            words += shorter.split()
    return words


@pytest.mark.parametrize(
    "page",
    [p for p in PAGES if any(words_of(c)[0] == "polemap" for c in commands(p))],
    ids=lambda path: path.name,
)
def test_every_command_runs(
    page: Path,
    garage: Garage,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    if page.name != "start.md":  # whose world takes seconds, as it says
        monkeypatch.setattr(drive, "load_scenario", small_scenario)
    for place, source in NEEDS.get(page.name, {}).items():
        garage.lay(source, tmp_path / place)
    helped: set[str] = set()
    for command in (*BEFORE.get(page.name, ()), *commands(page)):
        if words_of(command)[0] != "polemap":
            continue
        words = as_run(command)
        if "revs_250lm" in command:
            if not REVS.exists():
                continue
            garage.lay("revs", tmp_path / "revs_250lm" / REVS.name)
        if "--help" in words and words[0] in helped:
            continue
        helped |= {words[0]} if "--help" in words else set()
        if "-" in words:
            monkeypatch.setattr(sys, "stdin", (tmp_path / "recording.mcap").open())
        code = cli.run(words)
        said = capsys.readouterr()
        assert code == cli.GOOD, (command, said.err)
        if "--write-mapping" in words:
            _complete(tmp_path / words[-1])


def _complete(mapping: Path) -> None:
    """What the reader writes where the mapping says CHOOSE."""
    text = mapping.read_text().replace("wheelbase_m: CHOOSE", "wheelbase_m: 2.7")
    mapping.write_text(text.replace("turn: CHOOSE", "turn: counter_clockwise"))


def small_scenario(_: str | Path) -> Scenario:
    """A street of a few lamps under the name of any world."""
    corners = [[0, 0], [20, 0], [20, 20], [0, 20]]
    route = {"closed": True, "corner_radius_m": 6.0, "corners_m": corners}
    return Scenario.model_validate({**STREET, "route": route, "backdrop": False})


MODULE = re.compile(r"python -m benchmarks(?:\.([\w.]+))?(?: ([\w.]+))?")


@pytest.mark.parametrize(
    "command",
    sorted({c for page in PAGES for c in commands(page) if c.startswith("python")}),
)
def test_every_benchmark_is_there(command: str) -> None:
    """They run for minutes: imported, with a main of their own and the options that are named."""
    found = MODULE.match(command)
    assert found is not None
    if found[1] is None:
        assert found[2] in modules()
        return
    module = import_module(f"benchmarks.{found[1]}")
    text = Path(str(module.__file__)).read_text()
    assert "__main__" in text
    for option in re.findall(r" (--\w+)", command):
        assert f'"{option}"' in text or option[2:] in text, option


@pytest.mark.parametrize(
    "command", sorted({c for page in PAGES for c in commands(page) if c.startswith("make")})
)
def test_every_target_is_there(command: str) -> None:
    done = subprocess.run(
        [*command.split(), "--dry-run"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_every_page_has_its_place_in_the_site() -> None:
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^(\w+)$", index, re.MULTILINE))
    assert {page.stem for page in PAGES[1:]} - {"index"} == listed


def test_the_site_is_built_without_warnings(tmp_path: Path) -> None:
    """As `make site` does, which treats warnings as errors."""
    pytest.importorskip("sphinx")
    words = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"]
    done = subprocess.run(
        [*words, "-d", str(tmp_path / "doctrees"), str(ROOT / "docs"), str(tmp_path / "site")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "polemap.open_drive" in (tmp_path / "site" / "api.html").read_text(encoding="utf-8")
