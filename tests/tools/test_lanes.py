"""`polemap lanes` and `polemap estimate` on a drive whose pictures show a drawn lane."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.streams import OdometryStream
from polemap.drivelog.writers.folder import folder_writer
from polemap.stereo.rig import Mounting, StereoRig
from polemap.tools.cli import run
from polemap.vehicle.io import dump_car, load_car

RIG = StereoRig(320, 240, 300.0, 159.5, 119.5, 0.3, Mounting(1.5, 0.1, 1.3, pitch_rad=0.08))
STAMPS = 0.1 * np.arange(8)
HEADING, OFFSET = 0.02, 0.15  # at the passat's preview point, in a straight lane of 3.5 m


def picture(lane: bool, seed: int) -> np.ndarray:
    v, u = np.indices((RIG.height_px, RIG.width_px)).astype(np.float64)
    mount = RIG.vehicle_from_camera
    rays = np.stack(
        [(u - RIG.cx_px) / RIG.focal_px, (v - RIG.cy_px) / RIG.focal_px, np.ones_like(u)], axis=-1
    )
    rays = rays @ mount.rotation().T
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(rays[..., 2] < -1e-3, -mount.z_m / rays[..., 2], np.nan)
    x, y = mount.x_m + reach * rays[..., 0], mount.y_m + reach * rays[..., 1]
    middle = -OFFSET - np.tan(HEADING) * (x - 11.49)
    paint = (np.abs(y - middle - 1.75) < 0.07) | (np.abs(y - middle + 1.75) < 0.07)
    image = np.where(paint & lane, 190.0, 90.0)
    image += 3.0 * np.random.default_rng(seed).standard_normal(image.shape)
    return np.clip(image, 0, 255).astype(np.uint8)


def made(path: Path, *, lane: bool = True, signals: bool = True) -> Path:
    with folder_writer(
        path, name="lane", frame=EarthFrame("local", name="here"), wheelbase_m=2.71, rig=RIG
    ) as writer:
        for k, stamp in enumerate(STAMPS):
            image = picture(lane, k)
            writer.frame(float(stamp), float(stamp) + 0.05, image, image)
        ticks = 0.02 * np.arange(40)
        writer.odometry(OdometryStream(ticks, ticks, np.full(40, 8.0), np.zeros(40)))
        if signals:
            rows = np.arange(0.0, 0.8, 0.01)
            table = pd.DataFrame({"stamp_s": rows, "road_wheel_angle_rad": 0.0})
            table["yaw_rate_radps"], table["vx_mps"], table["sideslip_rad"] = 0.0, 8.0, 0.0
            table.to_csv(writer.folder / "signals.csv", index=False)
            truth = pd.DataFrame({"stamp_s": STAMPS, "heading_rad": HEADING})
            truth["lateral_offset_m"], truth["road_curvature_per_m"] = OFFSET, 0.0
            truth["lane_width_m"], truth["preview_m"] = 3.5, 11.49
            truth.to_csv(writer.folder / "lane_truth.csv", index=False)
    return path


def lanes(drive: Path, *more: str) -> int:
    return run(["lanes", str(drive), "--out", str(drive.parent / "out.csv"), "--force", *more])


def test_pictures_and_signals_become_one_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = made(tmp_path / "drive")
    assert lanes(drive, "--pictures", str(tmp_path / "seen"), "--every", "4") == 0
    said = capsys.readouterr().out
    assert "a lane in 6 (75 %), both markings in 6" in said
    assert "against the truth (6 pictures)" in said
    assert "next: polemap estimate" in said
    log = pd.read_csv(tmp_path / "out.csv")
    seen = log[log["heading_rad"].notna()]
    assert len(log) == 80
    assert len(seen) == 6
    assert seen["heading_rad"].to_numpy() == pytest.approx(HEADING, abs=0.005)
    assert seen["lateral_offset_m"].to_numpy() == pytest.approx(OFFSET, abs=0.05)
    assert seen["camera_arrival_s"].to_numpy() == pytest.approx(STAMPS[2:] + 0.05)
    assert seen["heading_sd_rad"].between(0.001, 0.02).all()
    shown = sorted((tmp_path / "seen").glob("*.png"))
    assert [path.name for path in shown] == ["000000.png", "000004.png"]
    picture = cv2.imread(str(shown[1]))
    assert picture.shape[0] == RIG.height_px
    assert picture.shape[1] > RIG.width_px
    assert ((picture[..., 1] > 200) & (picture[..., 2] < 120)).sum() > 100  # the lines, green


def test_without_signals_the_log_is_the_cameras(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = made(tmp_path / "drive", signals=False)
    assert lanes(drive, "--frames", "2:5") == 0
    assert "--signals LOG.csv" in capsys.readouterr().out
    assert pd.read_csv(tmp_path / "out.csv")["stamp_s"].tolist() == pytest.approx([0.2, 0.3, 0.4])


def test_estimate_takes_the_drive_itself(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, out = made(tmp_path / "drive"), tmp_path / "estimate.csv"
    arguments = ["estimate", str(drive), "--estimator", "clones", "--vehicle", "passat"]
    assert run([*arguments, "--out", str(out), "--force"]) == 0
    said = capsys.readouterr()
    assert "a lane in 6" in said.err
    last = pd.read_csv(out).iloc[-1]
    assert last["lateral_offset_m"] > 0.5 * OFFSET


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--preview", "80"), "--preview"),
        (("--frames", "3:4"), "two pictures at least"),
        (("--frames", "8:20"), "the drive has 8 frames"),
        (("--vehicle", "nobody"), "nobody"),
        (("--signals", "nowhere.csv"), "no such file"),
    ],
)
def test_what_cannot_be_is_one_line(
    more: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = made(tmp_path / "drive")
    assert lanes(drive, *more) == 2
    said = capsys.readouterr().err
    assert message in said
    assert not (tmp_path / "out.csv").exists()


def test_a_far_preview_of_the_car_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:

    car = tmp_path / "far.yaml"
    car.write_text(dump_car(replace(load_car("passat"), preview_m=90.0)))
    assert lanes(made(tmp_path / "drive"), "--vehicle", str(car)) == 2
    assert "give --preview" in capsys.readouterr().err


def test_a_road_without_paint_leaves_the_signals_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = made(tmp_path / "drive", lane=False)
    assert lanes(drive) == 2
    assert "no picture with a lane" in capsys.readouterr().err
    out = tmp_path / "estimate.csv"
    arguments = ["estimate", str(drive), "--vehicle", "passat", "--out", str(out), "--force"]
    assert run([*arguments, "--estimator", "bicycle"]) == 0
    assert run([*arguments, "--estimator", "clones"]) == 2
    assert "needs camera" in capsys.readouterr().err


def test_drives_that_lack_something_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = made(tmp_path / "bare", signals=False)
    arguments = ["--vehicle", "passat", "--out", str(tmp_path / "e.csv"), "--estimator", "bicycle"]
    assert run(["estimate", str(bare), *arguments]) == 2
    assert "no signals.csv" in capsys.readouterr().err
    text = (bare / "drive.yaml").read_text()
    (bare / "drive.yaml").write_text(text.replace("pitch_rad: 0.08", "pitch_rad: -0.6"))
    assert lanes(bare) == 2
    assert "check height and pitch" in capsys.readouterr().err
    with folder_writer(
        tmp_path / "blind", name="b", frame=EarthFrame("local", name="here"), wheelbase_m=2.7
    ) as writer:
        ticks = 0.02 * np.arange(40)
        writer.odometry(OdometryStream(ticks, ticks, np.full(40, 8.0), np.zeros(40)))
    assert lanes(tmp_path / "blind") == 2
    assert "no pictures to find a lane in" in capsys.readouterr().err


def test_a_truth_without_its_columns_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = made(tmp_path / "drive")
    (drive / "lane_truth.csv").write_text("stamp_s\n0.0\n")
    assert lanes(drive) == 2
    assert "lane_truth.csv" in capsys.readouterr().err
