"""`import polemap`: what it costs, and what it offers."""

from __future__ import annotations

import pydoc
import re
import subprocess
import sys
from pathlib import Path

import pytest

import polemap

ROOT = Path(__file__).resolve().parents[2]


def python(text: str, *arguments: str) -> str:
    """What a new interpreter prints."""
    done = subprocess.run(
        [sys.executable, "-c", text, *arguments], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_importing_loads_no_other_package() -> None:
    loaded = python("import sys, polemap; print(*{name.split('.')[0] for name in sys.modules})")
    assert not {"numpy", "scipy", "cv2", "pydantic", "pandas", "typer"} & set(loaded.split())


def test_settings_need_no_command_line() -> None:
    loaded = python("import sys, polemap; polemap.Settings(); print(*sys.modules)").split()
    assert not {"typer", "rich", "open3d", "matplotlib"} & set(loaded)


@pytest.mark.parametrize("name", polemap.__all__)
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(polemap, name) is not None
    assert name in dir(polemap)


def test_the_names_of_editors_are_those_of_the_program() -> None:
    text = (ROOT / "polemap" / "__init__.py").read_text(encoding="utf-8")
    shown = re.findall(r"^    from (\S+) import (.+)$", text, re.MULTILINE)
    typed = {name: home for home, names in shown for name in names.split(", ")}
    assert typed == polemap._HOMES
    assert sorted([*typed, "__version__"]) == sorted(polemap.__all__)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'polemap' has no attribute 'open_drives'"):
        _ = polemap.open_drives  # type: ignore[attr-defined]


def test_help_explains_every_name() -> None:
    text = pydoc.plain(pydoc.render_doc(polemap))
    for name in set(polemap.__all__) - {"__version__"}:
        assert re.search(rf"\b{name}\b", text), name
        assert pydoc.getdoc(getattr(polemap, name)), name


def test_python_m_polemap() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "polemap", "--version"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.stdout == f"polemap {polemap.__version__}\n"
