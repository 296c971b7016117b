"""A base install: what works without the extras, and what is said where one is missing."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from polemap.drivelog.writers.folder import write_drive
from polemap.extras import EXTRA_OF, MissingExtraError, need
from polemap.map.io import write_map
from tests.localize.point_drives import street_drive

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
ROOMS = ("stereo", "vehicle", "drivelog", "polemap", "localize", "electric", "evaluate",
         "simulate", "tools")  # fmt: skip
# what these need is the purpose of an extra
NOT_OF_THE_BASE = ("polemap.tools.report", "polemap.tools.demo", "polemap.map.formats.geoparquet")

WITHOUT_EXTRAS = f"""
import importlib.abc, sys

class Blocked(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {set(EXTRA_OF)!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Blocked())
NOT_OF_THE_BASE = {NOT_OF_THE_BASE!r}
"""


MISSING = {
    "simulate park_loop --out OUT": ("open3d", "simulate"),
    "study W14-margins": ("control", "simulate"),
    "study N13-cornering --out OUT": ("matplotlib", "report"),
    "report RUN --out OUT": ("matplotlib", "report"),
    "demo --out OUT": ("matplotlib", "report"),
    "map DRIVE --out OUT.gpkg --picture OUT.png": ("matplotlib", "report"),
    "map DRIVE --out OUT.gpkg --scheduler tcp://127.0.0.1:1": ("dask", "city"),
    "map DRIVE --out OUT.parquet": ("pyarrow", "gis"),
    "map --convert MAP --out OUT.osm.pbf": ("osmium", "gis"),
    "estimate LOG.mcap --estimator bicycle --vehicle passat --out OUT.csv": ("mcap", "bags"),
    "estimate LOG.parquet --estimator bicycle --vehicle passat --out OUT.csv": ("pyarrow", "gis"),
}
GOOD = (
    "map DRIVE --out BUILT.geojson --set polemap.mapping.observations_min=4",
    "localize DRIVE --map MAP --out BUILT --set localize.particles=100",
)
# all in one program: it is the imports that take their time
PROGRAM = """
import contextlib, importlib, io, json, pkgutil
import polemap
from polemap.tools import cli

for name in polemap.__all__:
    getattr(polemap, name)
for module in pkgutil.walk_packages(polemap.__path__, "polemap."):
    if not module.name.startswith(NOT_OF_THE_BASE) and not module.name.endswith("__main__"):
        importlib.import_module(module.name)
answers = {}
for words in json.loads(sys.argv[1]):
    with contextlib.redirect_stderr(io.StringIO()) as said, \
            contextlib.redirect_stdout(io.StringIO()):
        code = cli.run(words.split())
    answers[words] = code, said.getvalue()
print(json.dumps(answers))
"""


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = street_drive(2, duration_s=6.0)
    place = tmp_path_factory.mktemp("street")
    write_drive(made.drive, place / "drive")
    write_map(made.pole_map, place / "map.gpkg")
    return place


@pytest.fixture(scope="module")
def answers(street: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, str]]:
    """Exit code and complaint of every command line, in a program that can import no extra."""
    place = tmp_path_factory.mktemp("work")
    for ending in ("mcap", "parquet"):
        (place / f"log.{ending}").write_bytes(b"\0")
    places = {"OUT": place / "out", "RUN": place, "DRIVE": street / "drive",
              "MAP": street / "map.gpkg", "LOG": place / "log",
              "BUILT": place / "built"}  # fmt: skip

    def placed(words: str) -> str:
        for name, path in places.items():
            words = words.replace(name, str(path))
        return words

    wanted = {words: placed(words) for words in (*MISSING, *GOOD)}
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_EXTRAS + PROGRAM, json.dumps(list(wanted.values()))],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert not list(place.glob("out*"))
    assert (place / "built" / "kf.tum").is_file()
    found = json.loads(done.stdout)
    return {words: tuple(found[line]) for words, line in wanted.items()}


@pytest.mark.parametrize("words", MISSING)
def test_what_is_missing_is_named_with_what_installs_it(
    words: str, answers: dict[str, tuple[int, str]]
) -> None:
    package, extra = MISSING[words]
    wanted = f"this needs {package}, which is not installed: pip install 'polemap[{extra}]'"
    code, said = answers[words]
    # notes on what goes without an extra may stand before
    notes, last = said.splitlines()[:-1], said.splitlines()[-1]
    assert (code, last) == (2, f"polemap: {wanted}")
    assert all(note.startswith("note: no page: this needs ") for note in notes)


@pytest.mark.parametrize("words", GOOD)
def test_a_base_install_maps_and_localizes(words: str, answers: dict[str, tuple[int, str]]) -> None:
    assert answers[words][0] == 0, answers[words]


def test_a_module_that_no_extra_brings_stays_a_crash() -> None:
    with pytest.raises(ModuleNotFoundError, match="no_such_module"):
        need("no_such_module")
    assert issubclass(MissingExtraError, ImportError)


def test_every_extra_that_is_named_installs_the_package() -> None:
    extras = {
        name: {canonicalize_name(one) for line in lines for one in packages_of(line)}
        for name, lines in PROJECT["optional-dependencies"].items()
    }
    distributions = packages_distributions()
    for module, extra in EXTRA_OF.items():
        assert {canonicalize_name(name) for name in distributions[module]} & extras[extra], module


def test_what_is_imported_is_declared_and_the_other_way_round() -> None:
    names = {one.partition(".")[0] for one in imported()} | set(EXTRA_OF)
    names -= {*sys.stdlib_module_names, "polemap"}
    distributions = packages_distributions()
    used = {canonicalize_name(distributions[name][0]) for name in names}
    lines = [*PROJECT["dependencies"]]
    for extra in set(PROJECT["optional-dependencies"]) - {"dev", "all"}:
        lines += PROJECT["optional-dependencies"][extra]
    assert used == {canonicalize_name(one) for line in lines for one in packages_of(line)}


def packages_of(line: str) -> set[str]:
    """A requirement's package, and `distributed` of dask[distributed]."""
    requirement = Requirement(line)
    return {requirement.name, *requirement.extras}


def imported() -> set[str]:
    """Names of all modules that the rooms import or `need`."""
    found: set[str] = set()
    for room in ROOMS:
        for path in (ROOT / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Import):
                    found |= {alias.name for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and not node.level:
                    found.add(node.module or "")
    return found
