"""`polemap detect` and `polemap train` on a small rendered drive, and what they refuse."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from polemap.tools.cli import run
from tests.polemap.street import RIG, Thing, street

POLES = [Thing(14.0, 2.5, 0.25, 4.0), Thing(17.0, -3.0, 0.3, 4.0)]
DISTRACTION = Thing(16.0, 5.5, 0.9, 1.9)


WALL = Thing(15.0, 5.5, 3.0, 4.0)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five frames of an approach at 10 m/s, the map beside the drive."""
    return approach(tmp_path_factory.mktemp("drive") / "approach", [*POLES, DISTRACTION])


def approach(folder: Path, stand: list[Thing]) -> Path:
    """The drive past some things, with a map of the poles beside it."""
    (folder / "left").mkdir(parents=True)
    (folder / "right").mkdir()
    rng = np.random.default_rng(2)
    mount = RIG.vehicle_from_camera
    frames, odometry, reference = (["stamp_s,left,right"], ["stamp_s,speed_mps,yaw_rate_radps"],
                                   ["stamp_s,east_m,north_m,yaw_rad"])  # fmt: skip
    for step in range(5):
        things = [replace(t, x_m=t.x_m - step) for t in stand]
        left, right, _ = street(things, rng)
        for side, image in (("left", left), ("right", right)):
            noisy = image + rng.normal(0, 2, image.shape)
            cv2.imwrite(str(folder / side / f"{step}.png"), np.clip(noisy, 0, 255).astype(np.uint8))
        frames.append(f"{0.1 * step},left/{step}.png,right/{step}.png")
        odometry.append(f"{0.1 * step},10.0,0.0")
        reference.append(f"{0.1 * step},{1.0 * step},0.0,0.0")
    for name, rows in (("frames", frames), ("odometry", odometry), ("reference", reference)):
        (folder / f"{name}.csv").write_text("\n".join(rows) + "\n")
    (folder / "drive.yaml").write_text(
        "format_version: 1\nname: approach\nframe: {kind: local, name: street}\n"
        "vehicle: {wheelbase_m: 2.7}\ncamera:\n"
        f"  width_px: {RIG.width_px}\n  height_px: {RIG.height_px}\n  focal_px: {RIG.focal_px}\n"
        f"  cx_px: {RIG.cx_px}\n  cy_px: {RIG.cy_px}\n  baseline_m: {RIG.baseline_m}\n"
        f"  vehicle_from_camera: {{x_m: {mount.x_m}, y_m: {mount.y_m}, z_m: {mount.z_m}, "
        "roll_rad: 0.0, pitch_rad: 0.0, yaw_rad: 0.0}\n"
    )
    rows = "\n".join(f"{pole.x_m},{pole.y_m},{pole.width_m}" for pole in POLES)
    (folder.parent / "map.csv").write_text(f"east_m,north_m,width_m\n{rows}\n")
    return folder


def test_table_pictures_and_scores(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "found"
    # the drawn street has no texture to follow from one picture to the other
    scored = ["--evaluate", str(drive.parent / "map.csv"), "--pictures", "--force"]
    assert run(["detect", str(drive), "--out", str(out), "--frames", "0:4", *scored]) == 0
    with (out / "detections.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {int(row["frame"]) for row in rows} == {0, 1, 2, 3}
    sure = [row for row in rows if float(row["probability"]) >= 0.5]
    found = 0
    for step in range(4):
        points = [(float(r["x_m"]), float(r["y_m"])) for r in sure if int(r["frame"]) == step]
        for pole in POLES:
            gaps = [np.hypot(x - pole.x_m + step, y - pole.y_m) for x, y in points]
            found += min(gaps, default=np.inf) < 0.5
    # half of all looks at least: the drawn street is none that the classifier was trained on
    assert found >= 2 * len(POLES)
    assert sorted(p.name for p in out.glob("*.png")) == [f"{i:06d}.png" for i in range(4)]
    picture = cv2.imread(str(out / "000003.png"))
    assert picture.shape[0] == 2 * RIG.height_px
    said = capsys.readouterr().out
    assert "confirmed tracks" in said
    assert "next: polemap map" in said


def test_corners_are_written_where_they_are_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = approach(tmp_path / "walled", [*POLES, WALL])
    frames = ["--frames", "0:2", "--force"]
    asked = ["--set", "polemap.detection.kinds=[pole,corner]", "--pictures"]
    for name, more in (("poles", []), ("both", asked)):
        assert run(["detect", str(drive), "--out", str(tmp_path / name), *frames, *more]) == 0
    assert "corners (" in capsys.readouterr().out
    plain, both = (
        list(csv.DictReader((tmp_path / name / "detections.csv").open()))
        for name in ("poles", "both")
    )
    assert {"kind", "facing_rad"} & set(plain[0]) == set()
    corners = [row for row in both if row["kind"] == "corner"]
    poles = [row for row in both if row["kind"] == "pole"]
    assert corners
    assert len(corners) + len(poles) == len(both)
    # poles are found as without corners; tracks, which share what is learned, may be numbered anew
    assert [row["left_px"] for row in poles] == [row["left_px"] for row in plain]
    for row in corners:
        assert abs(float(row["facing_rad"])) <= np.pi
        assert row["left_px"] == row["right_px"]
        assert row["width_m"] == ""


def test_lines_are_written_where_they_are_asked_for(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain, more = tmp_path / "plain", tmp_path / "more"
    frames = ["--frames", "0:2", "--force"]
    kinds = ["--set", "polemap.detection.kinds=[pole,lane_marking,kerb]", "--pictures"]
    assert run(["detect", str(drive), "--out", str(plain), *frames]) == 0
    assert run(["detect", str(drive), "--out", str(more), *frames, *kinds]) == 0
    assert "pieces of lines:" in capsys.readouterr().out
    # poles do not know of lines
    assert (plain / "detections.csv").read_bytes() == (more / "detections.csv").read_bytes()
    assert not (plain / "lines.csv").exists()
    with (more / "lines.csv").open() as file:
        head, *rows = csv.reader(file)
    assert head[:6] == ["frame", "stamp_s", "kind", "style", "x0_m", "y0_m"]
    assert all(len(row) == len(head) for row in rows)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--frames", "3"], "expected A:B"),
        (["--frames", "4:2"], "0 <= A < B"),
        (["--frames", "9:12"], "the drive has 5 frames"),
        (["--set", "polemap.detection.model=nothing"], "no such classifier"),
        (["--set", "polemap.detection.colour=3"], "unknown key"),
        (["--set", "polemap.detection.kinds=[kerb]"], "pole among them"),
        (["--set", "polemap.detection.kinds=[pole,river]"], "lane_marking"),
    ],
)
def test_wrong_requests_leave_one_line_and_no_folder(
    drive: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    complaint: str,
) -> None:
    out = tmp_path / "found"
    assert run(["detect", str(drive), "--out", str(out), *arguments]) == 2
    told = capsys.readouterr().err
    assert complaint in told
    assert told.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_training_refuses_what_cannot_teach(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "model.json"
    assert run(["train", str(drive), "--out", str(out)]) == 2
    assert "expected DRIVE=MAP" in capsys.readouterr().err
    far = tmp_path / "far.csv"
    far.write_text("east_m,north_m\n500,500\n")
    assert run(["train", f"{drive}={far}", "--out", str(out)]) == 2
    assert "add drives" in capsys.readouterr().err
    assert not out.exists()


def test_training_writes_a_model_that_says_where_it_comes_from(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = tmp_path / "one.csv"
    one.write_text(f"east_m,north_m\n{POLES[0].x_m},{POLES[0].y_m}\n")
    out = tmp_path / "model.json"
    assert run(["train", f"{drive}={one}", "--out", str(out)]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["samples"]["approach"]["poles"] >= 3
    assert report["samples"]["approach"]["others"] >= 3
    assert json.loads(out.read_text())["origin"]["drives"] == ["approach"]
