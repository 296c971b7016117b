"""Whole drives: the same bytes from the same seed, truth that fits, faults and formats."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from polemap.drivelog.errors import ConfigError
from polemap.drivelog.readers.registry import open_drive
from polemap.map.io import read_map
from polemap.simulate import studio as module
from polemap.simulate.config import RenderConfig, SimulateConfig
from polemap.simulate.drive import count_frames, simulate_drive
from polemap.simulate.frame_faults import DroppedFrames
from polemap.simulate.map_faults import PolesAdded
from polemap.simulate.scenario import Scenario
from polemap.simulate.stream_faults import GnssOffset
from polemap.tools.cli import build_app
from polemap.vehicle.pose import inverse_transform_points, transform_points


def content(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.mark.slow
def test_the_seed_decides_every_byte_whatever_the_workers(
    tmp_path: Path, street: Scenario, small: SimulateConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_FEW", 2)
    two = small.model_copy(update={"render": RenderConfig(workers=2, shadows=False)})
    plans = {"a": (1, small), "b": (1, two), "c": (2, small)}
    made = {
        name: content(simulate_drive(street, tmp_path / name, 1, seed, config, objects=True))
        for name, (seed, config) in plans.items()
    }
    assert made["a"].keys() == made["b"].keys()
    assert made["a"] == made["b"]
    for name in ("left/000003.png", "odometry.csv", "gnss.csv", "objects.geojson", "truth.csv"):
        assert made["a"][name] != made["c"][name]


def test_a_drive_reads_back_with_its_truth(
    tmp_path: Path, street: Scenario, small: SimulateConfig
) -> None:
    truth = small.model_copy(
        update={"render": RenderConfig(workers=1, shadows=False, truth_images=True)}
    )
    out = simulate_drive(street, tmp_path / "d", 2, 3, truth, objects=True)
    drive = open_drive(out)
    assert len(drive.frame_stamps_s) == count_frames(street, 2, 3, truth)
    assert [lap.name for lap in drive.laps] == ["lap_1", "lap_2"]
    assert drive.problems == {}
    assert any("simulated" in note for note in drive.notes)
    pole_map = read_map(out / "objects.geojson", drive.frame)
    standing = np.genfromtxt(out / "standing.csv", delimiter=",", names=True, dtype=None)
    assert len(pole_map) == (standing["pole"] == 1).sum()
    motion = np.genfromtxt(out / "truth.csv", delimiter=",", names=True)
    assert drive.reference is not None
    poses = drive.reference.at(motion["stamp_s"][100:-100])
    error = np.hypot(poses[:, 0] - motion["east_m"][100:-100],
                     poses[:, 1] - motion["north_m"][100:-100])  # fmt: skip
    assert np.nanmax(error) < 0.15
    # a pole of the true map is seen where the truth pictures show it
    frame = 4
    disparity = cv2.imread(str(out / f"truth/disparity_left/{frame:06d}.png"), -1) / 256
    owners = cv2.imread(str(out / f"truth/objects/{frame:06d}.png"), -1)
    seen = [i for i in pole_map.ids if (owners == i).sum() >= 12]
    assert seen
    stamp = drive.frame_stamps_s[frame]
    pose = [np.interp(stamp, motion["stamp_s"], motion[k]) for k in ("east_m", "north_m")]
    yaw = np.interp(stamp, motion["stamp_s"], np.unwrap(motion["yaw_rad"]))
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    rig = drive.rig
    assert rig is not None
    for ident in seen:
        point = pole_map.points_m[pole_map.ids == ident][0]
        local = turn @ (point - pose)
        v, u = np.nonzero(owners == ident)
        low = v > np.quantile(v, 0.6)
        depth = rig.focal_px * rig.baseline_m / np.median(disparity[v[low], u[low]])
        assert depth == pytest.approx(local[0] - small.camera.mount_x_m, abs=0.35)
        left = (rig.cx_px - u[low].mean()) * depth / rig.focal_px + small.camera.mount_y_m
        assert left == pytest.approx(local[1], abs=0.35)


def test_signals_can_be_estimated_from(
    tmp_path: Path, street: Scenario, small: SimulateConfig
) -> None:
    out = simulate_drive(street, tmp_path / "d", 1, 3, small, objects=True, images=False)
    assert not (out / "frames.csv").exists()
    assert open_drive(out).rig is None
    signals = np.genfromtxt(out / "signals.csv", delimiter=",", names=True)
    drift = np.gradient(signals["sideslip_rad"], signals["stamp_s"])
    swing = signals["vx_mps"] * (signals["yaw_rate_radps"] + drift)
    # the file has every second step of the motion
    assert np.abs(signals["ay_mps2"] - swing).max() < 0.1
    assert np.abs(signals["ay_mps2"] - swing).mean() < 0.003
    assert np.allclose(np.diff(signals["stamp_s"]), 0.01)


def test_scans_hold_the_poles_that_stand_there(
    tmp_path: Path, street: Scenario, small: SimulateConfig
) -> None:
    out = simulate_drive(
        street, tmp_path / "d", 1, 3, small, objects=True, images=False, scans=True
    )
    drive = open_drive(out)
    assert drive.reference is not None
    true = read_map(out / "objects.geojson", drive.frame).points_m
    config = small.detector
    rate, length = config.rate_hz, drive.reference.stamp_s[-1] - drive.reference.stamp_s[0]
    assert len(drive.scans) == pytest.approx(rate * length, abs=2)
    off, seen, claims = [], 0, 0
    for scan, pose in zip(
        drive.scans, drive.reference.at(np.array([s.stamp_s for s in drive.scans])), strict=True
    ):
        assert scan.view is not None
        if not np.isfinite(pose).all():
            continue
        seen += int(scan.view.contains(inverse_transform_points(pose, true)).sum())
        claims += len(scan)
        gap = transform_points(pose, scan.points_vehicle_m)[:, None] - true[None]
        off.extend(np.hypot(gap[..., 0], gap[..., 1]).min(axis=1, initial=np.inf))
    # misses, clutter and the reference's noise: 0.02 m and 0.0008 rad
    right = np.array(off) < 1.5
    assert right.mean() > 1 - config.clutter_share - 0.05
    assert right.sum() / seen == pytest.approx(config.detected_share, abs=0.06)
    assert np.median(np.array(off)[right]) < 0.25
    assert claims < seen


def test_faults_end_up_in_the_folder(
    tmp_path: Path, street: Scenario, small: SimulateConfig
) -> None:
    sound = open_drive(simulate_drive(street, tmp_path / "s", 1, 3, small, images=False))
    faulty = small.model_copy(update={"faults": (GnssOffset(east_m=25), PolesAdded(share=0.5))})
    broken = open_drive(
        simulate_drive(street, tmp_path / "b", 1, 3, faulty, images=False, objects=True)
    )
    assert sound.gnss is not None
    assert broken.gnss is not None
    assert np.allclose(broken.gnss.east_m - sound.gnss.east_m, 25, atol=1e-3)
    assert np.allclose(broken.gnss.north_m, sound.gnss.north_m, atol=1e-3)
    true, mapped = (
        set(map(tuple, read_map(tmp_path / "b" / name, broken.frame).points_m))
        for name in ("objects.geojson", "mapped.geojson")
    )
    assert mapped < true


def test_the_truth_of_a_picture_goes_with_it_when_others_are_lost(
    tmp_path: Path, street: Scenario, small: SimulateConfig
) -> None:
    exact = small.model_copy(update={"render": RenderConfig(workers=1, truth_images=True)})
    folders = []
    for name, lost in (("s", ()), ("b", (DroppedFrames(from_s=2, until_s=6),))):
        config = exact.model_copy(update={"faults": lost})
        folders.append(simulate_drive(street, tmp_path / name, 1, 3, config))
    sound, broken = (open_drive(folder) for folder in folders)
    assert 3 < len(broken.frame_stamps_s) < len(sound.frame_stamps_s)
    for kind in ("disparity_left", "disparity_right", "objects"):
        files = sorted((folders[1] / "truth" / kind).glob("*.png"))
        assert len(files) == len(broken.frame_stamps_s)
        for file, stamp in zip(files, broken.frame_stamps_s, strict=True):
            (row,) = np.flatnonzero(np.isclose(sound.frame_stamps_s, stamp, atol=1e-6))
            original = folders[0] / "truth" / kind / f"{row:06d}.png"
            assert file.read_bytes() == original.read_bytes()


def test_the_command(tmp_path: Path, street: Scenario) -> None:
    world = tmp_path / "street.yaml"
    world.write_text(yaml.safe_dump(street.model_dump(mode="json")))
    app = build_app("simulate")
    runner = CliRunner()
    out = tmp_path / "out"
    done = runner.invoke(app, ["simulate", str(world), "--out", str(out), "--no-images"])
    assert done.exit_code == 0, done.output
    assert open_drive(out).odometry is not None
    said = done.output.splitlines()
    assert re.match(r"[\d.]+ s, \d+ m: \d+ odometry samples, \d+ fixes", said[-3])
    assert said[-2:] == [f"wrote {out}", f"next: polemap info {out}"]
    done = runner.invoke(app, ["simulate", str(world), "--out", str(tmp_path / "p"), "--scans"])
    assert done.exit_code == 0, done.output
    assert open_drive(tmp_path / "p").scans
    assert f"next: polemap map {tmp_path / 'p'} --out poles.gpkg" in done.output
    assert not open_drive(tmp_path / "p").has_frames
    named = runner.invoke(app, ["simulate", "--list"])
    assert "park_loop" in named.output
    deep = ["--format", "kitti_raw", "--set", "simulate.camera.bits=12"]
    refused = runner.invoke(app, ["simulate", str(world), "--out", str(tmp_path / "k"), *deep])
    assert isinstance(refused.exception, ConfigError)
    assert "simulate.camera.bits=8" in str(refused.exception)
