"""`polemap convert`: what goes in, what comes out, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.drive import open_drive
from polemap.tools import cli
from polemap.tools.convert import CONVERSIONS
from tests.drivelog.drives import write_small


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return write_small(tmp_path / "drive")


def convert(*words: object) -> int:
    return cli.run(["convert", *map(str, words)])


def test_a_drive_becomes_a_folder_with_the_same_streams(drive: Path, tmp_path: Path) -> None:
    assert convert(drive, "--out", tmp_path / "copy") == cli.GOOD
    old, new = open_drive(drive), open_drive(tmp_path / "copy")
    assert old.odometry is not None
    assert new.odometry is not None
    np.testing.assert_array_equal(old.odometry.speed_mps, new.odometry.speed_mps)
    np.testing.assert_array_equal(old.frame_stamps_s, new.frame_stamps_s)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["DRIVE", "--out", "X", "--to", "punchcards"], "--to takes folder"),
        (["missing", "--out", "X"], "no such file or folder"),
        (["DRIVE", "DRIVE", "--out", "X"], "takes one input"),
        (["empty", "--out", "X"], "neither a drive nor a run"),
    ],
)
def test_what_cannot_be_converted_is_one_line(
    words: list[str], message: str, drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    places = {"DRIVE": drive, "X": tmp_path / "x", "empty": tmp_path / "empty"}
    assert convert(*(places.get(word, word) for word in words)) == cli.USER_ERROR
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "x").exists()


def test_every_conversion_names_a_function_that_is_there() -> None:
    for place in CONVERSIONS.values():
        module, _, function = place.partition(":")
        path = Path(cli.__file__).parent / f"{module.rpartition('.')[2]}.py"
        assert f"def {function}(" in path.read_text(encoding="utf-8"), place
