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
ON_DISK = ("tools/", "drivelog/", "simulate/", "polemap/parsing/")
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
        if not name.startswith((*ON_DISK, *inside)) and not name.endswith("/io.py")
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


def is_rotation(node: ast.AST) -> bool:
    """Whether `c, s = cos(a), sin(a)` or the matrix `[[c, -s], [s, c]]` stands here."""
    if isinstance(node, ast.Tuple):
        calls = [part for part in node.elts if isinstance(part, ast.Call)]
        verbs = {getattr(c.func, "attr", getattr(c.func, "id", "")) for c in calls}
        angles = {ast.dump(argument) for c in calls for argument in c.args}
        return verbs == {"cos", "sin"} and len(calls) == 2 and len(angles) == 1
    if isinstance(node, ast.List) and len(node.elts) >= 2:
        rows = [row.elts[:2] for row in node.elts[:2] if isinstance(row, ast.List)]
        if len(rows) == 2 and all(len(row) == 2 for row in rows):
            (a, b), (c, d) = ([ast.dump(cell) for cell in row] for row in rows)
            minus = "UnaryOp(op=USub(), operand={})"
            return a == d and (b == minus.format(c) or c == minus.format(b))
    return False


def test_the_core_alone_turns_vectors_in_the_plane() -> None:
    """`vehicle.pose` and `vehicle.packed` have rotations; what follows is none of the plane's."""
    others = {
        "stereo/rig.py",  # pitch and roll
        "drivelog/tum.py",  # the half angle of a quaternion
        "localize/particle_filter/estimate.py",  # the circular mean of the particles' yaws
        "localize/particle_filter/particles.py",  # its sine and cosine, kept
        "electric/estimators/kinematic.py",  # a transition matrix, from the single track's step
        "electric/estimators/velocity_layer.py",
    }
    rooms = [*(name for name in ROOMS if name != "vehicle"), "polemap", "benchmarks"]
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for room in rooms
        for path in (ROOT / room).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.expr) and is_rotation(node)
    ]
    inside = tuple(f"polemap/{module}/" for module in ROOMS.values())
    left = {place for place in found if not place.startswith(inside)}
    assert {place for place in left if place.partition(":")[0] not in others} == set()


def test_a_rotation_is_known_when_it_stands_there() -> None:
    turns = (
        "c, s = np.cos(yaw), np.sin(yaw)",
        "c, s = cos(p[2]), sin(p[2])",
        "np.array([[c, -s], [s, c]])",
        "np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])",
    )
    for text in turns:
        assert any(is_rotation(node) for node in ast.walk(ast.parse(text))), text
    for text in ("np.array([[a, b], [b, a]])", "x, y = np.cos(a), np.sin(b)", "[[1, 2], [3, 4]]"):
        assert not any(is_rotation(node) for node in ast.walk(ast.parse(text))), text
