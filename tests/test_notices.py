"""What a package has to carry: citation, notices of others, types."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import yaml

import polemap
from docs.make_third_party import page

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def packages(text: str) -> dict[str, str]:
    return dict(re.findall(r"^\| ([\w.-]+) \| ([^|]+) \|", text, re.MULTILINE))


def test_every_package_that_comes_along_is_named_with_its_licence() -> None:
    """`make docs` writes the page; an environment with fewer extras has fewer packages."""
    written = packages((ROOT / "THIRD_PARTY.md").read_text(encoding="utf-8"))
    assert set(packages(page())) <= set(written)
    declared = {re.split(r"[>=;\[]", text)[0] for text in PROJECT["project"]["dependencies"]}
    assert {name.lower() for name in declared} <= {name.lower() for name in written}
    assert "LICENSE" in PROJECT["project"]["license-files"]
    assert "THIRD_PARTY.md" in PROJECT["project"]["license-files"]


def test_the_citation_is_of_this_version() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert cited["cff-version"] == "1.2.0"
    assert {"message", "title", "authors"} <= set(cited)
    assert cited["version"] == polemap.__version__ == PROJECT["project"]["version"]
    assert cited["license"] == PROJECT["project"]["license"]
