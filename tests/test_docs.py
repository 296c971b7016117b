"""The texts refer to what is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pydantic import BaseModel

from polemap.settings import Settings

ROOT = Path(__file__).resolve().parents[1]
DOCS = sorted((ROOT / "docs").glob("*.md"))
ROOMS = ("stereo", "vehicle", "drivelog", "localize", "electric", "evaluate", "simulate", "tools",
         "polemap", "benchmarks")  # fmt: skip
# the groups of entry points; members of a GeoJSON map; any room
NEITHER = {
    "polemap.readers",
    "polemap.matchers",
    "polemap.estimators",
    "polemap.doubtful",
    "polemap.frame",
    "polemap.ROOM",
}


def sources() -> dict[Path, str]:
    """Text of every module and kernel."""
    paths = [
        path
        for room in ROOMS
        for ending in ("py", "cpp", "hpp", "yaml")
        for path in (ROOT / room).rglob(f"*.{ending}")
        if not any(part.is_symlink() for part in path.parents)
    ]
    return {path: path.read_text(encoding="utf-8") for path in sorted(set(paths))}


@pytest.mark.parametrize("page", [ROOT / "README.md", *DOCS], ids=lambda path: path.name)
def test_links_lead_to_files(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
        if not target.startswith("http"):
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", [ROOT / "README.md", *DOCS], ids=lambda path: path.name)
def test_paths_and_modules_that_are_named_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for name in re.findall(rf"`((?:{'|'.join(ROOMS)}|tests|docs)/[\w./-]+)`", text):
        assert (ROOT / name).exists(), name


@pytest.mark.parametrize("page", [ROOT / "README.md", *DOCS], ids=lambda path: path.name)
def test_dotted_names_are_settings_or_modules(page: Path) -> None:
    known = settings_keys(Settings) | NEITHER
    text = page.read_text(encoding="utf-8")
    for name in re.findall(r"(?:--set |`)((?:stereo|polemap|localize|simulate)\.[\w.]+)", text):
        assert name.rstrip(".") in known or is_code(name), name


def is_code(name: str) -> bool:
    """Whether a dotted name is a module of `polemap`, or something in one."""
    path = ROOT / "polemap" / name.removeprefix("polemap.").replace(".", "/")
    if path.exists() or path.with_suffix(".py").exists():
        return True
    for home in (path.parent.with_suffix(".py"), path.parent / "__init__.py"):
        if home.exists() and re.search(rf"\b{path.name}\b", home.read_text(encoding="utf-8")):
            return True
    return False


def settings_keys(model: type[BaseModel], prefix: str = "") -> set[str]:
    """Dotted names of all settings and of their groups."""
    found: set[str] = set()
    for name, field in model.model_fields.items():
        found.add(prefix + name)
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            found |= settings_keys(field.annotation, f"{prefix}{name}.")
    return found


def test_docstrings_name_pages_and_headings_that_exist() -> None:
    headings = set(
        re.findall(r"^#+ (.+)$", (ROOT / "docs/errata.md").read_text(encoding="utf-8"), re.M)
    )
    for path, text in sources().items():
        for page in re.findall(r"\bdocs/([\w./]+\.(?:md|py))", text):
            assert (ROOT / "docs" / page).exists(), f"{path}: docs/{page}"
        for section in re.findall(r"\berrata\.md, ([A-Z2][\w\s-]+?)(?:[.;(),]|$)", text):
            wanted = " ".join(section.split())
            assert any(wanted.startswith(heading) for heading in headings), f"{path}: {wanted}"


def test_every_source_is_in_the_bibliography() -> None:
    known = (ROOT / "docs" / "bibliography.md").read_text(encoding="utf-8")
    for path, text in sources().items():
        for key in re.findall(r"\b([SWN]1[2-6])\b", text):
            assert f"| {key} |" in known, f"{path}: {key}"
        for source in re.findall(r"Source: (?:[A-Z]\. )?([A-Z][a-z]+)(?:,| and | et al)", text):
            assert source in known, f"{path}: {source}"


def test_nothing_outside_the_repository_is_named() -> None:
    for path, text in sources().items():
        if "benchmarks" not in path.parts:
            found = re.search(r"CONTRACT\b|ERRATA\b|\.\./shared", text)
            assert found is None, f"{path}: {found}"


def test_the_way_of_a_frame_names_what_stands_in_its_files() -> None:
    text = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    rows = text.partition("## The way of a frame")[2].partition("##")[0].splitlines()
    steps = [row.split("|")[1:4] for row in rows if row.startswith("| `")]
    assert len(steps) > 20
    code = "\n".join(sources().values())
    for places, file, handed_on in steps:
        source = (ROOT / file.strip(" `")).read_text(encoding="utf-8")
        for name in re.findall(r"`(?:\w*\.)?(\w+)`", places):
            assert f"def {name}(" in source, f"{file}: {name}"
        for name in re.findall(r"`(\w+)`", handed_on):
            assert re.search(rf"\bclass {name}\b", code), f"{file}: {name}"
