"""`polemap new`: a folder to fill, which tells what is still to be given, and then is a drive."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from polemap.drivelog.errors import Mistakes
from polemap.drivelog.readers.columns import FILES
from polemap.drivelog.readers.drive_yaml import DriveYaml
from polemap.drivelog.readers.registry import open_drive
from polemap.tools import cli

ALL = ",".join(FILES)


def new(*words: object) -> int:
    return cli.run(["new", *map(str, words)])


def test_what_is_to_be_given_is_told_and_suffices(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = tmp_path / "tuesday"
    assert new(drive, "--sensors", ALL) == cli.GOOD
    text = (drive / "drive.yaml").read_text(encoding="utf-8")
    for key in DriveYaml.model_fields:
        assert key in text
    with pytest.raises(Mistakes) as error:
        open_drive(drive)
    open_keys = len(re.findall(r"^(?!#).*: CHOOSE", text, re.MULTILINE))
    assert len(error.value.mistakes) == open_keys == 11
    assert all("still says CHOOSE; give " in mistake for mistake in error.value.mistakes)
    text = text.replace("frame: CHOOSE", "frame: {kind: utm, epsg: 32632}")
    text = re.sub(r"_px: CHOOSE", "_px: 480", text)
    (drive / "drive.yaml").write_text(text.replace("CHOOSE", "1.5"), encoding="utf-8")
    assert open_drive(drive).rig is not None
    assert "next: fill them" in capsys.readouterr().out


def test_with_options_it_is_a_drive_at_once(tmp_path: Path) -> None:
    drive = tmp_path / "yard"
    words = ["--local", "yard", "--wheelbase", 2.5, "--sensors", "odometry,gnss", "--allow-links"]
    assert new(drive, *words) == cli.GOOD
    opened = open_drive(drive)
    assert (opened.name, opened.wheelbase_m, str(opened.frame)) == (
        "yard", 2.5, "local frame 'yard'",
    )  # fmt: skip
    assert (drive / "gnss.csv").read_text() == "stamp_s,east_m,north_m,hdop\n"
    assert new(tmp_path / "utm", "--epsg", 32632, "--wheelbase", 2.5) == cli.GOOD
    assert "latitude_deg" in (tmp_path / "utm" / "gnss.csv").read_text()


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive = tmp_path / "a"
    assert new(drive) == cli.GOOD
    before = (drive / "drive.yaml").read_bytes()
    assert new(drive, "--wheelbase", 3) == cli.USER_ERROR
    assert "is there already" in capsys.readouterr().err
    assert (drive / "drive.yaml").read_bytes() == before
    (tmp_path / "file").write_text("mine")
    assert new(tmp_path / "file") == cli.USER_ERROR
    (tmp_path / "empty").mkdir()
    assert new(tmp_path / "empty") == cli.GOOD


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--sensors", "odometer"], "did you mean 'odometry'"),
        (["--epsg", "4326"], "no UTM zone"),
        (["--epsg", "32632", "--local", "x"], "two frames"),
    ],
)
def test_wrong_options(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert new(tmp_path / "a", *words) == cli.USER_ERROR
    assert message in capsys.readouterr().err
    assert not (tmp_path / "a").exists()
