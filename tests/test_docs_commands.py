"""Commands in the docs: every one has verbs and options that exist, and those marked so are run."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from polemap.tools import cli

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
# "run": below; the others lack what only a user has, or render for minutes
MARKS = ("run", "needs data", "takes minutes")
BLOCK = re.compile(r"(?:<!-- ([\w ]+) -->\n)?^```\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(page: Path) -> Iterator[tuple[str, list[str]]]:
    """Mark and commands of each block that holds any."""
    for mark, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        found = commands(text)
        if found:
            yield mark, found


def commands(text: str) -> list[str]:
    """Lines that call polemap, continued ones joined, without comments."""
    lines = re.sub(r"\\\n\s*", " ", text)
    # a quoted value may go on over lines
    lines = re.sub(r"'[^']*'", lambda m: m[0].replace("\n", " "), lines)
    return [line.strip() for line in lines.splitlines() if line.strip().startswith("polemap")]


def words_of(command: str) -> list[str]:
    return shlex.split(command, comments=True)[1:]


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_every_block_is_run_or_says_why_not(page: Path) -> None:
    for mark, found in blocks(page):
        assert mark in MARKS, f"{page.name}: put <!-- run --> or another of {MARKS}: {found[0]}"


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_verbs_and_options_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    inline = [code for code in re.findall(r"`(polemap [^`\n]+)`", text) if "|" not in code]
    for command in [*(c for _, found in blocks(page) for c in found), *inline]:
        words = words_of(command.replace("...", "").replace("…", ""))
        if not words or words[0] in ("VERB", "--help", "--install-completion"):
            continue
        assert words[0] in cli.VERBS, f"{page.name}: {command}"
        group: Any = get_command(cli.build_app(words[0]))
        verb = group.commands[words[0]]
        known = {name for option in verb.params for name in (*option.opts, *option.secondary_opts)}
        for word in words[1:]:
            if word.startswith("--"):
                assert word.partition("=")[0] in known | {"--help"}, f"{page.name}: {command}"


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if any(mark == "run" for mark, _ in blocks(page))],
    ids=lambda path: path.name,
)
def test_marked_blocks_run_in_their_order(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for mark, found in blocks(page):
        for command in found if mark == "run" else ():
            code = cli.run(words_of(command))
            said = capsys.readouterr()
            assert code == cli.GOOD, (command, said.err)
            assert "not trustworthy" not in said.out + said.err, command


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
