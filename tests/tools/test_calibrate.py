"""`polemap calibrate` on a street with known truth, and on what cannot be calibrated."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from polemap.drivelog.readers.registry import open_drive
from polemap.stereo.rig import Mounting
from polemap.tools.cli import run
from tests.calibration.street import DELAY_S, SCALE, TRUE, write_street
from tests.drivelog.drives import write_small

STATED = Mounting(1.2, 0.1, 1.5)


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_street(tmp_path_factory.mktemp("street") / "drive", stated=STATED)


def test_a_street_gives_back_its_truth(
    street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, pictures = tmp_path / "found.yaml", tmp_path / "pictures"
    options = ["--pairs", "12", "--out", str(out), "--pictures", str(pictures), "--json"]
    assert run(["calibrate", str(street), *options]) == 0
    tree = json.loads(capsys.readouterr().out)
    found = {q["name"].rpartition(".")[2]: q for q in tree["quantities"]}
    truth = {
        "z_m": (TRUE.z_m, 0.02), "roll_rad": (TRUE.roll_rad, 0.006),
        "pitch_rad": (TRUE.pitch_rad, 0.004), "yaw_rad": (TRUE.yaw_rad, 0.004),
        "speed_scale": (SCALE, 0.005), "delay_s": (DELAY_S, 0.01),
    }  # fmt: skip
    for name, (value, tolerance) in truth.items():
        assert found[name]["found"] == pytest.approx(value, abs=tolerance), name
        assert abs(found[name]["found"] - value) < 4 * found[name]["sd"], name
    wrong = {finding["stream"] for finding in tree["findings"]}
    assert "camera.vehicle_from_camera.z_m" in wrong
    assert "odometry.delay_s" in wrong
    assert {path.name for path in pictures.iterdir()} >= {"rows.png", "road.png", "odometry.png"}
    # what was written is taken over as it stands
    head = yaml.safe_load((street / "drive.yaml").read_text())
    new = yaml.safe_load(out.read_text())
    head["camera"]["vehicle_from_camera"] = new["camera"]["vehicle_from_camera"]
    head["odometry"] = new["odometry"]
    before = (street / "drive.yaml").read_text()
    (street / "drive.yaml").write_text(yaml.safe_dump(head))
    try:
        assert run(["calibrate", str(street), "--pairs", "6", "--json"]) == 0
        again = json.loads(capsys.readouterr().out)
        assert not again["findings"]
        # what is corrected already counts: the file would say the same again
        scale = next(q for q in again["quantities"] if q["name"] == "odometry.speed_scale")
        assert scale["stated"] == new["odometry"]["speed_scale"]
        assert scale["found"] == pytest.approx(SCALE, abs=0.005)
        assert any("odometry.csv is corrected" in note for note in open_drive(street).notes)
    finally:
        (street / "drive.yaml").write_text(before)


def test_without_a_reference_the_camera_is_the_witness(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = write_street(tmp_path / "drive", stated=TRUE, reference=False, lower_px=1.0)
    assert run(["calibrate", str(drive), "--pairs", "8"]) == 0
    text = capsys.readouterr().out
    assert "against the camera" in text
    assert "warning    camera: rows differ by 1.0" in text


def test_a_wrong_baseline_is_seen_against_the_reference(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = write_street(tmp_path / "drive", stated=TRUE, frames=32, baseline=1.06)
    assert run(["calibrate", str(drive), "--pairs", "6", "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert tree["camera_scale"][0] == pytest.approx(1.06, abs=0.012)
    assert "camera_scale" in {finding["kind"] for finding in tree["findings"]}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--out", "found.txt"], "found.txt: what was found is written as .yaml"),
        (["--pairs", "1"], "'--pairs'"),
    ],
)
def test_options_that_cannot_be(
    street: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    assert run(["calibrate", str(street), *arguments]) == 2
    assert message in capsys.readouterr().err


def test_drives_with_nothing_to_calibrate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    still = write_small(tmp_path / "still", images=0)
    (still / "reference.csv").unlink()
    assert run(["calibrate", str(still)]) == 2
    assert "nothing to calibrate" in capsys.readouterr().err
    noise = write_small(tmp_path / "noise", images=6)
    assert run(["calibrate", str(noise)]) == 2
    assert "features match in" in capsys.readouterr().err
