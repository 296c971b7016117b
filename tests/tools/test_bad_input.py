"""What a user can get wrong, through the commands: one clear line, exit 2, nothing half-written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from polemap.drivelog.frames import EarthFrame
from polemap.map.io import read_map, write_map
from polemap.tools import cli
from tests.drivelog.drives import edit, write_small

Damage = Callable[[Path], None]


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return write_small(tmp_path / "drive")


def _refused(
    capsys: pytest.CaptureFixture[str], arguments: list[object], out: Path, *parts: str
) -> None:
    before = sorted(out.parent.iterdir())
    code = cli.run([str(word) for word in arguments])
    error = capsys.readouterr().err
    assert code == cli.USER_ERROR, error
    assert error.startswith("polemap: ")
    refusals = [x for x in error.splitlines() if not x.startswith("polemap: warning: ")]
    assert len(refusals) == 1, error
    for part in parts:
        assert part in error
    assert sorted(out.parent.iterdir()) == before


def _truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-200])


@pytest.mark.parametrize(
    ("damage", "parts"),
    [
        (lambda d: (d / "left" / "000001.png").unlink(), ["left/000001.png"]),
        (lambda d: _truncate(d / "right" / "000002.png"), ["right/000002.png"]),
        (
            lambda d: edit(d / "drive.yaml", "format_version: 1", "format_version: 9"),
            ["drive.yaml", "format_version", "found 9"],
        ),
        (lambda d: (d / "drive.yaml").unlink(), ["drive"]),
    ],
    ids=["missing image", "truncated image", "unknown version", "no drive.yaml"],
)
def test_damaged_drives(
    drive: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    damage: Damage,
    parts: list[str],
) -> None:
    damage(drive)
    out = tmp_path / "seen"
    _refused(capsys, ["detect", drive, "--out", out], out, *parts)


def _swap_rows(path: Path) -> None:
    lines = path.read_text().splitlines()
    lines[3], lines[4] = lines[4], lines[3]
    path.write_text("\n".join(lines) + "\n")


def test_unsorted_stamps(drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _swap_rows(drive / "odometry.csv")
    out = tmp_path / "map.gpkg"
    _refused(capsys, ["map", drive, "--out", out], out, "odometry.csv", "line 5")


def test_nan_is_counted_and_the_drive_goes_on(
    drive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (drive / "odometry.csv").read_text().splitlines()
    cells = lines[7].split(",")
    lines[7] = ",".join([cells[0], "nan", *cells[2:]])
    (drive / "odometry.csv").write_text("\n".join(lines) + "\n")
    assert cli.run(["info", str(drive)]) == cli.GOOD
    shown = capsys.readouterr().out
    assert "1 x odometry not finite" in shown


def test_a_map_of_another_frame(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    csv, pole_map, out = tmp_path / "a.csv", tmp_path / "other.gpkg", tmp_path / "run"
    csv.write_text("east_m,north_m\n10,20\n")
    write_map(read_map(csv, EarthFrame("local", name="victoria_park")), pole_map)
    arguments = ["localize", drive, "--map", pole_map, "--out", out]
    _refused(capsys, arguments, out, "victoria_park", "32632")


def test_an_empty_map(drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pole_map, out = tmp_path / "empty.csv", tmp_path / "run"
    pole_map.write_text("east_m,north_m\n")
    _refused(capsys, ["localize", drive, "--map", pole_map, "--out", out], out, "empty.csv")


@pytest.mark.parametrize(
    ("setting", "parts"),
    [
        ("localize.partikles=5", ["partikles", "did you mean 'localize.particles'?"]),
        ("localize.gnss_sd_m=5", ["gnss_sd_m", "did you mean 'localize.gnss.sd_m'?"]),
        ("localize.learn_noise=false", ["did you mean 'localize.odometry.learn_noise'?"]),
        ("localize.particles=-5", ["localize.particles", "-5"]),
        ("localize.particles", ["key=value"]),
        ("nowhere.particles=5", ["nowhere"]),
    ],
)
def test_settings(
    drive: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    setting: str,
    parts: list[str],
) -> None:
    out, pole_map = tmp_path / "run", tmp_path / "map.csv"
    pole_map.write_text("east_m,north_m\n458000,5430000\n")
    arguments = ["localize", drive, "--map", pole_map, "--out", out, "--set", setting]
    _refused(capsys, arguments, out, *parts)


def test_the_output_may_not_replace_the_users_folder(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine, pole_map = tmp_path / "mine", tmp_path / "map.csv"
    mine.mkdir()
    (mine / "thesis.tex").write_text("years of work")
    pole_map.write_text("east_m,north_m\n458000,5430000\n")
    arguments = ["localize", drive, "--map", pole_map, "--out", mine]
    _refused(capsys, arguments, mine, "mine", "did not write")
    assert (mine / "thesis.tex").exists()


@pytest.mark.parametrize("verb", [["simulate", "park_loop"], ["demo"], ["localize", "drive"]])
def test_a_negative_seed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: list[str]
) -> None:
    out = tmp_path / "out"
    _refused(
        capsys, [*verb, "--out", out, "--seed", -1], out, "'--seed'", "greater than or equal to 0"
    )


def test_a_demo_where_nothing_can_be_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    _refused(capsys, ["demo", "--out", tmp_path / "file" / "demo"], tmp_path / "file", "file")
