"""What import-linter cannot see: where the disk is touched, and that the rooms have one name."""

from __future__ import annotations

import ast
from pathlib import Path

import polemap

ROOT = Path(__file__).resolve().parents[1]
ROOMS = {
    "stereo": "stereo",
    "vehicle": "vehicle",
    "drivelog": "drivelog",
    "localize": "localize",
    "electric": "electric",
    "evaluate": "evaluation",
    "simulate": "simulate",
    "tools": "tools",
}
ON_DISK = ("tools", "drivelog", "simulate")
# --config; lap.csv of a run's drive
READERS = ("polemap/settings.py", "evaluate/routes.py")
TOUCHES_DISK = {
    *("open", "read_text", "write_text", "read_bytes", "write_bytes", "mkdir", "unlink", "rename"),
    *("iterdir", "imread", "imwrite", "loadtxt", "savetxt", "fromfile", "tofile", "savez"),
    *("read_csv", "read_parquet", "to_csv", "atomic_file", "atomic_folder", "rmtree"),
}


def off_disk() -> list[str]:
    """Every module of the rooms that have no business with files, but for their io.py."""
    files = [*(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))]
    files += (ROOT / "polemap").rglob("*.py")
    names = {path.relative_to(ROOT).as_posix() for path in files}
    inside = {f"polemap/{module}/" for module in ROOMS.values()}
    return sorted(
        name
        for name in names
        if not name.startswith((*(f"{room}/" for room in ON_DISK), *inside))
        and not name.endswith("/io.py")
        and name not in READERS
    )


def test_only_some_rooms_and_io_touch_the_disk() -> None:
    found = []
    for name in off_disk():
        for node in ast.walk(ast.parse((ROOT / name).read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                verb = getattr(node.func, "attr", getattr(node.func, "id", ""))
                if verb in TOUCHES_DISK:
                    found.append(f"{name}:{node.lineno} {verb}()")
    assert not found


def test_every_room_is_a_link_inside_the_package() -> None:
    for folder, module in ROOMS.items():
        link = ROOT / "polemap" / module
        assert link.is_symlink(), f"polemap/{module}"
        assert link.resolve() == ROOT / folder


def test_every_folder_of_modules_is_a_package() -> None:
    """setuptools packs packages only: a folder without __init__.py would be left out."""
    for name in (*ROOMS, "polemap"):
        for path in (ROOT / name).rglob("*.py"):
            assert (path.parent / "__init__.py").is_file(), path.parent


def test_type_checkers_of_users_see_the_types() -> None:
    assert (Path(polemap.__file__).parent / "py.typed").is_file()
