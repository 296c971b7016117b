"""One writer at a time, and nothing left behind by those that were killed."""

from __future__ import annotations

import errno
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pytest

from polemap.drivelog.atomic import atomic_file, atomic_folder, reserved
from polemap.drivelog.errors import OutputError
from polemap.drivelog.results import workspace
from polemap.drivelog.results.workspace import fresh_folder, own_workspace, sweep

PROGRAM = """
import sys
from pathlib import Path
from typing import Any
from polemap.drivelog.atomic import atomic_file, atomic_folder, reserved, scratch_folder
with {what} as part:
    {then}
    print("at work", flush=True)
    sys.stdin.read()
"""


@contextmanager
def another(what: str, then: str = "pass") -> Iterator[subprocess.Popen[bytes]]:
    """Another process that stands in the middle of writing; it is killed at the end."""
    program = PROGRAM.format(what=what, then=then)
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"at work\n"
        yield process
        process.send_signal(signal.SIGKILL)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_second_writer_of_a_folder_is_refused_until_the_first_is_gone(tmp_path: Path) -> None:
    target = tmp_path / "run"
    fill = '(part / "a").write_text("half")'
    with another(f'atomic_folder(Path("{target}"), "run")', fill):
        with (
            pytest.raises(OutputError, match="another polemap is writing it now"),
            atomic_folder(target, "run"),
        ):
            pass
        sweep(tmp_path)
        assert names(tmp_path) == [".run.part"]
    assert names(tmp_path) == [".run.part"]
    with atomic_folder(target, "run") as part:
        (part / "b").write_text("whole")
    assert names(tmp_path) == ["run"]
    assert names(target) == [".polemap", "b"]


def test_a_reserved_place_is_written_by_its_holder_only(tmp_path: Path) -> None:
    target = tmp_path / "map.gpkg"
    with reserved(target), reserved(target):
        with atomic_file(target) as part:
            part.write_text("1")
        assert target.read_text() == "1"
    assert names(tmp_path) == ["map.gpkg"]
    with (
        another(f'reserved(Path("{target}"))'),
        pytest.raises(OutputError, match="another polemap is writing it now"),
        reserved(target),
    ):
        pass


def test_files_may_be_written_by_several_and_the_leavings_of_the_dead_go(tmp_path: Path) -> None:
    target = tmp_path / "scans.npz"
    with another(f'atomic_file(Path("{target}"))', 'part.write_text("half")'):
        with atomic_file(target) as part:
            part.write_text("whole")
        sweep(tmp_path)
        assert len(names(tmp_path)) == 2
    assert len(names(tmp_path)) == 2
    sweep(tmp_path)
    assert names(tmp_path) == ["scans.npz"]
    assert target.read_text() == "whole"


def test_scratch_of_the_dead_is_swept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with another("scratch_folder()", '(part / "a").write_text("half")'):
        assert len(names(tmp_path)) == 1
    sweep(tmp_path)
    assert names(tmp_path) == []


def test_a_folder_of_somebody_else_is_neither_swept_nor_used(tmp_path: Path) -> None:
    foreign = tmp_path / ".run.part"
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("years of work")
    sweep(tmp_path)
    with pytest.raises(OutputError, match="is in the way"), atomic_folder(tmp_path / "run", "run"):
        pass
    (foreign / "lock").write_text("")
    sweep(tmp_path)
    (foreign / "lock").write_text("mine, and longer than any signature of polemap")
    sweep(tmp_path)
    assert names(foreign) == ["lock", "thesis.tex"]


def test_a_file_that_came_into_the_old_result_meanwhile_is_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "run"
    with atomic_folder(target, "run") as part:
        (part / "a").write_text("old")
    with atomic_folder(target, "run") as part:
        (part / "a").write_text("new")
        (target / "notes.txt").write_text("written while polemap worked")
    assert (target / "a").read_text() == "new"
    assert names(target) == [".polemap", "a"]
    kept = tmp_path / "run.kept"
    assert (kept / "notes.txt").read_text() == "written while polemap worked"
    assert f"they are in {kept}" in capsys.readouterr().err


def test_folders_made_for_a_result_that_fails_go_again(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), atomic_folder(tmp_path / "a" / "b", "run"):
        raise ZeroDivisionError
    assert names(tmp_path) == []


def test_a_long_name_is_written_too(tmp_path: Path) -> None:
    name = "m" * 255
    with atomic_file(tmp_path / name) as part:
        part.write_text("x")
    with atomic_folder(tmp_path / ("n" * 255), "run") as part:
        (part / "a").write_text("x")
    assert names(tmp_path) == [name, "n" * 255]
    with (
        pytest.raises(OutputError, match="cannot be written \\(File name too long"),
        atomic_file(tmp_path / ("o" * 300)),
    ):
        pass


@pytest.mark.parametrize("place", ["lock.open", "try_lock", "still_there", "_clear"])
@pytest.mark.parametrize("writer", [workspace.own_workspace, workspace.fresh_folder])
def test_a_signal_while_a_workspace_is_made_leaves_none(
    place: str, writer: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A signal between the folder, its lock and the work: nothing holds what was made by then."""

    def interrupted(*_args: Any, **_kept: Any) -> Any:
        monkeypatch.undo()
        raise KeyboardInterrupt

    target = tmp_path / "out"
    if place == "lock.open":
        monkeypatch.setattr(workspace.os, "open", interrupted)
    else:
        monkeypatch.setattr(workspace, place, interrupted)
    with pytest.raises(KeyboardInterrupt), writer(target):
        pass
    assert list(tmp_path.iterdir()) == []
    with writer(target) as made:
        assert made.is_dir()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("make", [own_workspace, fresh_folder])
def test_a_disk_without_room_for_the_lock_names_the_result(
    make: Callable[[Path], AbstractContextManager[Path]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(*_args: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("polemap.drivelog.results.workspace.os.write", full)
        with pytest.raises(OutputError, match=r"run: cannot be written \(No space"):
            make(tmp_path / "run").__enter__()
    assert list(tmp_path.iterdir()) == []
