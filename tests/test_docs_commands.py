"""Every command of README and docs is run, in the order of its page.

The paths that a page takes for the reader's own are made here, small; docs_runs.py says what makes
a command short. It has one table of those that are left, each with the reason: of them, the help is
run here, and `make check-docs` runs the long ones as they stand.
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
from polemap.tools import cli
from tests.docs_commands import PAGES, ROOT, commands, words_of
from tests.docs_data import REVS, Garage
from tests.docs_runs import BEFORE, EVERYWHERE, LEFT, NEEDS, as_run, is_mention, left

ALL = list(dict.fromkeys(command for page in PAGES for command in commands(page)))
LONG = [
    command
    for command in ALL
    if (found := left(command)) is not None and found.long and not is_mention(command)
]


# what ran: a command of one page is not repeated for another that lays the same things
Ran = set[tuple[str, ...]]


@pytest.fixture(scope="session")
def ran() -> Ran:
    return set()


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


@pytest.mark.parametrize(
    "page",
    [p for p in PAGES if any(words_of(c)[0] == "polemap" for c in commands(p))],
    ids=lambda path: path.name,
)
def test_every_command_runs(
    page: Path,
    garage: Garage,
    ran: Ran,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    needs = EVERYWHERE | NEEDS.get(page.name, {})
    for place, source in needs.items():
        if source != "revs" or REVS.exists():
            garage.lay(source, tmp_path / place)
    for command in (*BEFORE.get(page.name, ()), *commands(page)):
        if words_of(command)[0] != "polemap" or ("revs_250lm" in command and not REVS.exists()):
            continue
        words = as_run(command)
        run = tuple(needs.get(word, word) for word in words)
        if run in ran and "--out" not in words:
            continue
        ran.add(run)
        if "-" in words:
            monkeypatch.setattr(sys, "stdin", (tmp_path / "recording.mcap").open())
        code = cli.run(words)
        said = capsys.readouterr()
        assert code == cli.GOOD, (command, said.err)
        if page.name == "start.md":
            assert "not trustworthy" not in said.out + said.err, command
        if "--write-mapping" in words:
            _complete(tmp_path / words[-1])


def _complete(mapping: Path) -> None:
    """What the reader writes where the mapping says CHOOSE."""
    text = mapping.read_text().replace("wheelbase_m: CHOOSE", "wheelbase_m: 2.7")
    mapping.write_text(text.replace("turn: CHOOSE", "turn: counter_clockwise"))


@pytest.mark.docs
@pytest.mark.parametrize("command", LONG)
def test_long_commands_run_as_they_stand(command: str, tmp_path: Path) -> None:
    words = words_of(command)
    by_make = words[0] == "make"
    program = words if by_make else [sys.executable, "-m", *words]
    done = subprocess.run(
        program, cwd=ROOT if by_make else tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_what_is_left_is_still_in_the_docs() -> None:
    for one in LEFT:
        assert any(re.search(one.pattern, command) for command in ALL), one


MODULE = re.compile(r"python -m benchmarks(?:\.([\w.]+))?(?: ([\w.]+))?")


@pytest.mark.parametrize("command", [c for c in ALL if c.startswith("python")])
def test_every_benchmark_is_there(command: str) -> None:
    """They run for minutes: imported, with a main of their own and the options that are named."""
    found = MODULE.match(command)
    assert found is not None
    if found[1] is None:
        assert found[2] in modules()
        return
    module = import_module(f"benchmarks.{found[1]}")
    if hasattr(module, "__path__"):
        module = import_module(f"benchmarks.{found[1]}.__main__")
    text = Path(str(module.__file__)).read_text()
    assert "__main__" in text
    for option in re.findall(r" (--\w+)", command):
        assert f'"{option}"' in text or option[2:] in text, option


@pytest.mark.parametrize("command", [c for c in ALL if c.startswith("make")])
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
