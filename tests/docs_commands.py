"""The commands of README and docs, as they stand there."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from glob import glob
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
_BLOCK = re.compile(r"^```(?:bash|sh)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_INDENTED = re.compile(r"(?:^    (?:polemap|python|make) .*\n(?:^     +.*\n)*)+", re.MULTILINE)
_INLINE = re.compile(r"`((?:polemap|python -m|make) [^`\n|…]*[^`\n|….])`")
_PROGRAMS = ("polemap", "python", "make", "pip")


def commands(page: Path) -> list[str]:
    """Those of blocks and of running text in their order, each once, without comments."""
    text = page.read_text(encoding="utf-8")
    found: dict[int, list[str]] = {}
    for block in (*_BLOCK.finditer(text), *_INDENTED.finditer(text)):
        found[block.start()] = list(_lines(block[block.lastindex or 0]))
    for inline in _INLINE.finditer(text):
        found[inline.start()] = [inline[1].strip()]
    ordered = [command for place in sorted(found) for command in found[place]]
    return list(dict.fromkeys(ordered))


def _lines(text: str) -> Iterator[str]:
    """Lines of a block that start a program, with what the shell joins to them."""
    text = re.sub(r"\\\n\s*", " ", text)
    # a quoted value may go on over lines
    text = re.sub(r"'[^']*'", lambda m: m[0].replace("\n", " "), text)
    for line in text.splitlines():
        words = line.split("|")[-1].split()
        if words and words[0] in _PROGRAMS:
            yield re.sub(r"(^| )#.*", "", line).strip()


def words_of(command: str) -> list[str]:
    """As a shell passes them in the working directory."""
    words = shlex.split(command.rpartition("| ")[2] or command, comments=True)
    return [
        told
        for word in words
        for told in ((sorted(glob(word)) or [word]) if word.endswith("/*") else [word])
    ]
