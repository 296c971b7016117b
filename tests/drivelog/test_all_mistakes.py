"""A drive folder that is wrong in many ways is told all of them at once, each with its remedy."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest
from pydantic import BaseModel, ConfigDict, ValidationError

from polemap.drivelog.errors import InputError, Mistakes
from polemap.drivelog.problems import validation_mistakes
from polemap.drivelog.readers.registry import open_drive
from polemap.tools import cli
from tests.drivelog.drives import edit

WRONG = """
format_version: 2
name: ""
frame: {kind: utm, epsg: 4326}
vehicle: {wheelbase_m: -1}
camera:
  width_px: 0
  height_px: yes
  focal_px: wide
  cy_px: .nan
  baseline_m: -0.3
  vehicle_from_camera: {x_m: 1.9}
gnss_antenna: {x_m: 1}
pole_detector: {x_m: 99, y_m: 0.5, bearing_min_rad: -1.57, range_max_m: 0}
notes: [1]
allow_links: perhaps
"""
PLACES = (
    *("format_version", "name", "frame", "vehicle.wheelbase_m", "camera.width_px"),
    *("camera.height_px", "camera.focal_px", "camera.cx_px", "camera.cy_px", "camera.baseline_m"),
    *("camera.vehicle_from_camera.y_m", "camera.vehicle_from_camera.z_m", "gnss_antenna.y_m"),
    *("pole_detector.x_m", "pole_detector.bearing_max_rad", "pole_detector.range_max_m"),
    *("notes.0", "allow_links"),
)


def test_every_wrong_key_is_told_at_once(folder: Path) -> None:
    (folder / "drive.yaml").write_text(WRONG, encoding="utf-8")
    with pytest.raises(Mistakes) as error:
        open_drive(folder)
    told = error.value.mistakes
    for place in PLACES:
        assert sum(line.startswith(f"{place}: ") for line in told) == 1, (place, told)
    assert len(told) == len(PLACES)
    assert "is missing; add metres above the ground, such as 1.3" in "".join(told)


def test_columns_of_all_files_are_told_with_the_keys(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "drive.yaml").write_text("name: x\n", encoding="utf-8")
    edit(folder / "odometry.csv", "speed_mps,yaw_rate_radps", "speed,yaw_rate")
    edit(folder / "poles.csv", "var_x_m2", "sigma")
    edit(folder / "reference.csv", "yaw_rad", "heading")
    assert cli.run(["info", str(folder)]) == cli.USER_ERROR
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].endswith("6 mistakes")
    assert all(line.startswith("polemap: ") for line in lines)
    for words in (
        "drive.yaml: format_version: is missing",
        "drive.yaml: frame: is missing",
        "drive.yaml: vehicle: is missing",
        "odometry.csv: columns 'speed_mps', 'yaw_rate_radps' are missing (found: stamp_s, speed",
        "poles.csv: column 'var_x_m2' is missing",
        "reference.csv: column 'yaw_rad' is missing",
    ):
        assert sum(words in line for line in lines) == 1, (words, lines)


def test_files_that_are_wrong_inside_are_told_together(folder: Path) -> None:
    edit(folder / "odometry.csv", "10.000000", "ten")
    edit(folder / "reference.csv", "100.000000", "north")
    edit(folder / "laps.csv", "two,", "one,")
    with pytest.raises(Mistakes) as error:
        open_drive(folder)
    assert len(error.value.mistakes) == 3
    assert "\n" not in str(error.value)


def test_mistakes_pass_from_process_to_process() -> None:
    again = copy.deepcopy(Mistakes("a.yaml", ["one", "two"]))
    assert again.lines == ("a.yaml: 2 mistakes", "one", "two")


def test_one_mistake_is_one_line(folder: Path) -> None:
    edit(folder / "odometry.csv", "speed_mps", "speed")
    with pytest.raises(InputError, match=r"odometry.csv: column 'speed_mps' is missing") as error:
        open_drive(folder)
    assert not isinstance(error.value, Mistakes)


@pytest.mark.parametrize(
    ("mark", "name"), [(";", "semicolons"), ("\t", "tabs"), ("|", "bars"), (" ", "blanks")]
)
def test_the_separator_is_named(folder: Path, mark: str, name: str) -> None:
    path = folder / "odometry.csv"
    path.write_text(path.read_text(encoding="utf-8").replace(",", mark), encoding="utf-8")
    with pytest.raises(InputError, match=f"its columns are separated by {name}"):
        open_drive(folder)


def test_pictures_outside_need_to_be_allowed_and_are_said(folder: Path, tmp_path: Path) -> None:
    """Both by an absolute path and by a link inside of the folder."""
    outside = tmp_path / "elsewhere"
    (folder / "right").rename(outside)
    (folder / "right").symlink_to(outside)
    with pytest.raises(InputError, match=r"leads out of the drive folder; .*allow_links: true"):
        open_drive(folder)
    with (folder / "drive.yaml").open("a", encoding="utf-8") as file:
        file.write("allow_links: true\n")
    drive = open_drive(folder)
    drive.read_frame(1)
    assert any("3 pictures lie outside" in note for note in drive.notes)
    edit(folder / "frames.csv", "left/000000.png", str(folder / "left" / "000000.png"))
    (folder / "right").unlink()
    index = folder / "frames.csv"
    index.write_text(index.read_text().replace("right/", f"{outside}/"), encoding="utf-8")
    open_drive(folder).read_frame(2)


@pytest.mark.parametrize("key", ["<!DOCTYPE x>", "function-before", "<x"])
def test_an_unknown_key_of_any_shape_is_named(key: str) -> None:
    class Model(BaseModel):
        model_config = ConfigDict(extra="forbid")
        known_m: float = 1.0

    with pytest.raises(ValidationError) as caught:
        Model.model_validate({key: 1})
    mistakes = validation_mistakes(caught.value, Model)
    assert mistakes == [f"{key}: unknown key; known: known_m"]
