"""A comma2k19 segment: one drawn with known mount and delay, a real one, and what is refused."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from polemap.drivelog.errors import InputError
from polemap.electric.comma2k19.io import FILES, read_comma2k19
from polemap.tools.cli import run
from polemap.vehicle.io import load_car

YAW_RAD, PITCH_RAD, DELAY_S, SECONDS = 0.02, 0.06, 0.12, 40.0
SLIP_RAD = 0.01


@pytest.fixture
def drawn(tmp_path: Path) -> Path:
    """Straight on to 25 s, then a left turn with side-slip; the phone looks 0.02 rad left."""
    t = np.arange(0.0, SECONDS, 0.01)
    speed = 12.0 + 3.0 * np.sin(0.4 * t)
    turning = t > 25.0
    yaw_rate = np.where(turning, 0.1, 0.0)
    yaw = np.cumsum(yaw_rate) * 0.01
    slip = np.where(turning, SLIP_RAD, 0.0)
    # camera axes (forward, right, down) in axes of the car of the same kind, and those in east,
    # north, up at a spot whose up is the ECEF x axis: east is y, north is z
    camera = Rotation.from_euler("ZY", [-YAW_RAD, -PITCH_RAD])
    east_north_up = Rotation.from_matrix([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    car = Rotation.from_euler("z", yaw[:, None]) * Rotation.from_euler("x", np.pi)
    course = yaw + slip
    ground = np.stack([speed * np.cos(course), speed * np.sin(course), 0.0 * t], axis=1)
    quat = (east_north_up * car * camera).as_quat()
    ecef = east_north_up.apply(ground)
    rate = camera.inv().apply(np.stack([0.0 * t, 0.0 * t, -yaw_rate], axis=1))
    push = np.stack([np.gradient(speed, t), -speed * yaw_rate, np.full(len(t), -9.81)], axis=1)
    force = camera.inv().apply(push)
    fixes = np.arange(20, len(t) - 20, 10)
    tables = {
        "accelerometer": (t, force),
        "gyro": (t, rate),
        "wheel_speed": (t, np.repeat(speed[:, None], 4, axis=1)),
        "steering": (t, np.degrees(16.0 * yaw_rate * 2.65 / speed)[:, None]),
        "reference": (t[::5], np.column_stack([ecef, quat[:, [3, 0, 1, 2]]])[::5]),
        "gnss": (
            t[fixes] + DELAY_S,
            np.column_stack([speed, 90.0 - np.degrees(course), 1e6 + 1e3 * t])[fixes],
        ),
    }
    for name, (stamps, values) in tables.items():
        table = pd.DataFrame(values, columns=list(FILES[name]))
        table.insert(0, "stamp_s", stamps)
        table.to_csv(tmp_path / f"{name}.csv", index=False)
    return tmp_path


def test_mount_delay_and_axes_are_found(drawn: Path) -> None:
    segment = read_comma2k19(drawn, 16.0)
    assert segment.mount_yaw_rad == pytest.approx(YAW_RAD, abs=1e-4)
    assert segment.mount_pitch_rad == pytest.approx(PITCH_RAD, abs=1e-4)
    assert segment.gnss_delay_s == pytest.approx(DELAY_S, abs=0.006)
    log, late = segment.log, segment.log.stamp_s > 26.0
    late &= log.stamp_s < SECONDS - 0.2
    mean = {name: float(np.nanmean(log.columns[name][late])) for name in log.columns}
    assert mean["sideslip_rad"] == pytest.approx(SLIP_RAD, abs=2e-4)
    assert mean["yaw_rate_radps"] == pytest.approx(0.1, abs=1e-4)
    assert mean["ay_mps2"] == pytest.approx(0.1 * mean["vx_mps"], rel=1e-3)
    np.testing.assert_allclose(
        log.columns["vx_mps"][late], log.columns["vx_reference_mps"][late], rtol=1e-3
    )
    rows = np.flatnonzero(np.isfinite(log.columns["course_rad"]) & late)
    turned = np.diff(log.columns["course_rad"][rows]) / np.diff(log.stamp_s[rows])
    np.testing.assert_allclose(turned, 0.1, atol=0.015)
    np.testing.assert_allclose(
        log.columns["gnss_arrival_s"][rows] - log.stamp_s[rows], DELAY_S, atol=0.011
    )


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: (f / "gyro.csv").write_text("stamp_s,forward_radps\n1,2\n"), "no column right"),
        (lambda f: (f / "gnss.csv").unlink(), "no such file"),
        (lambda f: (f / "steering.csv").write_text("stamp_s,steering_wheel_deg\n1,x\n"), "row 2"),
        (
            lambda f: (f / "steering.csv").write_text("stamp_s,steering_wheel_deg\n2,1\n1,1\n"),
            "row 3 does not follow",
        ),
        (
            lambda f: (f / "steering.csv").write_text("stamp_s,steering_wheel_deg\n2,1\n"),
            "two at least",
        ),
    ],
)
def test_bad_segments_name_the_place(
    drawn: Path, spoil: Callable[[Path], object], message: str
) -> None:
    spoil(drawn)
    with pytest.raises(InputError, match=message):
        read_comma2k19(drawn, 16.0)


def test_a_car_without_a_ratio_and_one_that_stands_are_refused(drawn: Path) -> None:
    with pytest.raises(InputError, match="steering_ratio"):
        read_comma2k19(drawn, load_car("coms").steering_ratio)
    table = pd.read_csv(drawn / "reference.csv")
    table[["ecef_vx_mps", "ecef_vy_mps", "ecef_vz_mps"]] = 0.0
    table.to_csv(drawn / "reference.csv", index=False)
    with pytest.raises(InputError, match="moves too little"):
        read_comma2k19(drawn, 16.0)


def test_real_sensors_give_velocities(
    recording: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Better than the wheels (0.150 m/s) and than the late GNSS speed held (0.139 m/s)."""
    folder = tmp_path / "segment"
    shutil.copytree(recording("comma2k19"), folder)
    lines = {}
    for name in ("two_layer", "two_layer_reconstructed", "two_layer_ignored"):
        call = ["estimate", str(folder), "--estimator", name, "--vehicle", "rav4"]
        call += ["--set", "gps_slots=3", "--set", "gyro_sd_radps=0.005"]
        call += ["--set", "heading_walk_rad=0.01", "--out", str(tmp_path / "out.csv")]
        assert run(call) == 0
        said = capsys.readouterr()
        assert "mount yaw" in said.err
        lines[name] = json.loads(said.out)
    for name in ("two_layer", "two_layer_reconstructed"):
        assert lines[name]["vx_rmse_mps"] < 0.06
        assert lines[name]["vy_rmse_mps"] < 0.06
    assert lines["two_layer_ignored"]["vx_rmse_mps"] > 1.5 * lines["two_layer"]["vx_rmse_mps"]
    log = read_comma2k19(folder, load_car("rav4").steering_ratio).log
    wheels = log.columns["vx_mps"] - log.columns["vx_reference_mps"]
    rmse = float(np.sqrt(np.nanmean(wheels[log.stamp_s > log.stamp_s[0] + 20.0] ** 2)))
    assert lines["two_layer"]["vx_rmse_mps"] < 0.5 * rmse
