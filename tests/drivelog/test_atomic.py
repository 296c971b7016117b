"""Results appear whole or not at all, and nobody's files are lost to them."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from polemap.drivelog.atomic import atomic_file, atomic_folder
from polemap.drivelog.errors import OutputError


def _fail_after_writing(path: Path) -> None:
    path.write_text("half")
    raise OSError("disk full")


def test_a_file_appears_only_when_its_block_ends_well(tmp_path: Path) -> None:
    target = tmp_path / "new" / "a.csv"
    with pytest.raises(OSError, match="disk full"), atomic_file(target) as part:
        _fail_after_writing(part)
    assert list(tmp_path.iterdir()) == []
    with atomic_file(target) as part:
        part.write_text("whole")
        assert not target.exists()
    assert target.read_text() == "whole"
    assert [p.name for p in target.parent.iterdir()] == ["a.csv"]


def test_a_failed_rewrite_keeps_the_old_folder(tmp_path: Path) -> None:
    target = tmp_path / "run"
    with atomic_folder(target, "run") as part:
        (part / "a").write_text("old")
    with pytest.raises(OSError, match="disk full"), atomic_folder(target, "run") as part:
        _fail_after_writing(part / "a")
    assert (target / "a").read_text() == "old"
    with atomic_folder(target, "run") as part:
        (part / "b").write_text("new")
    assert sorted(p.name for p in target.iterdir()) == [".polemap", "b"]
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


def test_a_folder_of_the_users_own_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with (
        pytest.raises(OutputError, match="holds files that polemap did not write"),
        atomic_folder(tmp_path, "run"),
    ):
        pass
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_a_file_in_the_way_is_named(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("")
    with pytest.raises(OutputError, match="x: is a file"), atomic_folder(tmp_path / "x", "run"):
        pass
    with pytest.raises(OutputError, match="is a folder"), atomic_file(tmp_path):
        pass
    with pytest.raises(OutputError, match="cannot be written"), atomic_file(tmp_path / "x" / "y"):
        pass


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO])
def test_a_full_disk_is_told_with_the_result_s_name(tmp_path: Path, number: int) -> None:
    for make in (atomic_file(tmp_path / "a"), atomic_folder(tmp_path / "a", "run")):
        with pytest.raises(OSError, match="full") as caught, make:
            raise OSError(number, "full")
        assert caught.value.filename == str(tmp_path / "a")
        assert not list(tmp_path.iterdir())
