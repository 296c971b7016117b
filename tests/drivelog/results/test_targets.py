"""A result never lands on, above or below what it is made from, nor on what is no file."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from polemap.drivelog.atomic import atomic_file, atomic_folder, check_files, check_folder
from polemap.drivelog.errors import OutputError
from polemap.drivelog.results.targets import real_target


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    folder = tmp_path / "drives" / "monday"
    with atomic_folder(folder, "drive") as part:
        (part / "drive.yaml").write_text("x: 1\n")
    return folder


@pytest.mark.parametrize(
    ("out", "message"),
    [
        ("drives/monday", "is the input .*monday itself"),
        ("drives", "holds the input .*monday"),
        ("drives/monday/run", "lies inside the input .*monday"),
        ("drives/monday/a/b", "lies inside the input .*monday"),
        ("link", "is the input .*monday itself"),
        ("link/run", "lies inside the input .*monday"),
        ("drives/../drives/monday/.", "is the input"),
    ],
)
def test_an_input_is_not_replaced(drive: Path, tmp_path: Path, out: str, message: str) -> None:
    (tmp_path / "link").symlink_to(drive)
    with pytest.raises(OutputError, match=message):
        check_folder(tmp_path / out, "drive", [None, drive])
    with (
        pytest.raises(OutputError, match=message),
        atomic_folder(tmp_path / out, "drive", [None, drive]),
    ):
        pass
    assert (drive / "drive.yaml").read_text() == "x: 1\n"


def test_an_input_behind_a_link_is_guarded_where_it_really_lies(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "map.csv").write_text("east_m,north_m\n")
    (tmp_path / "map.csv").symlink_to(tmp_path / "out" / "map.csv")
    with pytest.raises(OutputError, match="holds the input"):
        check_folder(tmp_path / "out", "run", [tmp_path / "map.csv"])
    with pytest.raises(OutputError, match="is the input"):
        check_files([tmp_path / "out" / "map.csv"], [tmp_path / "map.csv"])


def test_another_kind_of_result_is_not_replaced(drive: Path) -> None:
    with pytest.raises(OutputError, match="holds a drive, and a run is to be written there"):
        check_folder(drive, "run")
    check_folder(drive, "drive")


def test_inputs_that_are_missing_or_apart_are_no_obstacle(drive: Path, tmp_path: Path) -> None:
    check_folder(tmp_path / "drives" / "tuesday", "drive", [drive, "avenue", None])
    check_folder(tmp_path / "drives" / "mon", "drive", [drive])


def test_two_results_in_one_file_are_refused(tmp_path: Path) -> None:
    check_files([tmp_path / "a.png", None, tmp_path / "b.png"])
    with pytest.raises(OutputError, match="asked for as two results"):
        check_files([tmp_path / "a.png", None, tmp_path / "x" / ".." / "a.png"])


def test_what_is_no_file_is_refused_and_stays(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "socket"))
        for name, message in (("pipe", "a pipe"), ("link", "a pipe"), ("socket", "a socket")):
            for use in (atomic_file, lambda path: atomic_folder(path, "run")):
                with (
                    pytest.raises(OutputError, match=f"{name}: is {message}"),
                    use(tmp_path / name),
                ):
                    pass
    with pytest.raises(OutputError, match="null: is a device"), atomic_file(Path("/dev/null")):
        pass
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with (
        pytest.raises(OutputError, match="loop: cannot be written"),
        atomic_file(tmp_path / "loop"),
    ):
        pass
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "loop", "pipe", "socket"]
    with (
        pytest.raises(OutputError, match="cannot be written"),
        atomic_file(Path(f"{tmp_path}/a\0b")),
    ):
        pass


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real.csv").write_text("old")
    (tmp_path / "link.csv").symlink_to(tmp_path / "real.csv")
    with atomic_file(tmp_path / "link.csv") as part:
        part.write_text("new")
    assert (tmp_path / "link.csv").is_symlink()
    assert (tmp_path / "real.csv").read_text() == "new"


@pytest.mark.parametrize("folder", [True, False])
def test_a_place_below_what_is_no_folder_is_refused(tmp_path: Path, folder: bool) -> None:
    (tmp_path / "file").write_text("x")
    for inside in ("file/out.gpkg", "file/deep/er/out.gpkg"):
        with pytest.raises(OutputError, match="file is no folder"):
            real_target(tmp_path / inside, folder=folder)
    assert real_target(tmp_path / "a" / "b" / "out", folder=folder).name == "out"
