"""`import polemap`: what it costs, and what it offers."""

from __future__ import annotations

import pydoc
import re
import subprocess
import sys
from pathlib import Path

import pytest

import polemap
from polemap.drivelog.writers.folder import write_drive
from tests.localize.point_drives import street_drive

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


@pytest.mark.parametrize(
    "program",
    [
        "import polemap; [getattr(polemap, name) for name in polemap.__all__]",
        "from polemap.tools import cli; [cli.build_app(verb) for verb in cli.VERBS]",
    ],
    ids=["public names", "help of every verb"],
)
def test_what_is_slow_to_import_waits_for_the_work_that_needs_it(program: str) -> None:
    """A car's program and `polemap VERB --help` start without it; scipy loads its parts itself."""
    loaded = set(python(f"{program}; import sys; print(*sys.modules)").split())
    assert "polemap.localize.localizer" in loaded
    slow = {
        "dask", "geopandas", "gtsam", "jinja2", "matplotlib", "mcap", "open3d", "osmium", "pandas",
        "pyarrow", "pyogrio", "rerun", "rosbags", "shapely", "sklearn", "websockets",
    }  # fmt: skip
    parts = ("interpolate", "linalg", "ndimage", "optimize", "signal", "sparse", "spatial",
             "special", "stats")  # fmt: skip
    assert not (slow | {f"scipy.{part}" for part in parts}) & loaded


def test_no_sample_waits_for_an_import(tmp_path: Path) -> None:
    """What a localizer needs is loaded when it is made, not while the car drives."""
    made = street_drive(2, duration_s=6.0)
    write_drive(made.drive, tmp_path / "drive")
    polemap.write_map(made.pole_map, tmp_path / "map.geojson")
    program = """
import sys
import polemap
from polemap.track.config import TrackingConfig
from polemap.track.tracking import PoleTracker
drive = polemap.open_drive(sys.argv[1])
settings = polemap.Settings(localize={"particles": 100})
localizer = polemap.Localizer(polemap.read_map(sys.argv[2], drive.frame), drive, settings)
before, updates = set(sys.modules), 0
for sample in drive.samples():
    updates += localizer.add_sample(sample) is not None
    localizer.pose_at(sample.arrival_s)
assert updates
print(*(name for name in set(sys.modules) - before if name.startswith("scipy.")))
PoleTracker(TrackingConfig())
assert "scipy.optimize" in sys.modules
"""
    assert not python(program, str(tmp_path / "drive"), str(tmp_path / "map.geojson")).strip()


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
