"""Rows, road, heading and odometry from what they are made of, against the truth."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from polemap.calibration.check import _odometry
from polemap.calibration.ground import (
    GroundPlane,
    angles_of,
    ground_mounting,
    on_road,
    road_plane,
)
from polemap.calibration.motion import CameraSteps, heading
from polemap.calibration.odometry import Witness, odometry_errors, of_camera
from polemap.calibration.result import Quantity
from polemap.calibration.rows import agreement
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.plausibility.features import PairMatch
from polemap.drivelog.streams import OdometryStream, ReferenceStream
from polemap.stereo.rig import Mounting, rotation_from_angles
from tests.calibration.street import SIZE, TRUE, motion, rig


def turned_matches(angles: tuple[float, float, float], lower_m: float) -> list[PairMatch]:
    """Matches of a right camera that is turned by yaw, pitch, roll and stands lower."""
    camera = rig(Mounting())
    axes = Mounting().rotation()
    out = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        left = np.column_stack([rng.uniform(20, SIZE[0] - 20, 400), rng.uniform(5, 195, 400)])
        points = camera.camera_points(left[:, 0], left[:, 1], rng.uniform(4, 60, 400))
        turn = axes.T @ rotation_from_angles(*angles) @ axes
        right = (points - np.array([camera.baseline_m, lower_m, 0.0])) @ turn
        u = camera.cx_px + camera.focal_px * right[:, 0] / right[:, 2]
        v = camera.cy_px + camera.focal_px * right[:, 1] / right[:, 2]
        step = np.column_stack([u, v]) - left + 0.05 * rng.standard_normal((400, 2))
        out.append(PairMatch(left, step))
    return out


def test_a_turned_right_camera_is_seen_in_the_rows() -> None:
    yaw, pitch, roll = 0.006, 0.002, -0.003
    found = agreement(turned_matches((yaw, pitch, roll), 0.004), rig(Mounting()), "made")
    assert found.pitch_rad == pytest.approx(pitch, abs=1e-4)
    assert found.roll_rad == pytest.approx(roll, abs=1e-4)
    assert found.yaw_rad == pytest.approx(yaw, abs=6e-4)
    assert found.lower_m == pytest.approx(0.004, abs=5e-4)
    assert found.rest_px == pytest.approx(0.05, abs=0.01)
    assert found.across_px > 1.0


def test_too_few_matches_are_refused() -> None:
    few = [PairMatch(np.zeros((9, 2)), np.zeros((9, 2)))]
    with pytest.raises(InputError, match="9 features match in 1 pairs, 100 are needed"):
        agreement(few, rig(), "made")


def road_disparity(mount: Mounting) -> np.ndarray:
    camera = rig(mount)
    v, u = np.indices((SIZE[1], SIZE[0]))
    rays = np.stack([(u - camera.cx_px), (v - camera.cy_px), np.full(u.shape, camera.focal_px)], -1)
    down = -mount.rotation()[2]
    disparity = camera.baseline_m / mount.z_m * (rays @ down)
    return np.where(disparity > 0.5, disparity, np.nan).astype(np.float32)


def test_the_road_gives_height_pitch_and_roll_from_a_wrong_mounting() -> None:
    disparity = road_disparity(TRUE)
    rng = np.random.default_rng(1)
    disparity += 0.3 * rng.standard_normal(disparity.shape).astype(np.float32)
    disparity[:, :150] = 25.0  # a wall
    plane = road_plane(disparity, rig(Mounting(1.2, 0.1, 1.7)), rng)
    assert plane is not None
    assert plane.height_m == pytest.approx(TRUE.z_m, abs=0.01)
    pitch, roll = angles_of(plane.normal)
    assert pitch == pytest.approx(TRUE.pitch_rad, abs=0.002)
    assert roll == pytest.approx(TRUE.roll_rad, abs=0.004)
    road = on_road(disparity, rig(), plane)
    assert not road[:50].any()
    assert road[150:, 200:400].mean() > 0.95


@pytest.mark.parametrize("what", ["nothing", "a wall", "noise"])
def test_no_road_is_no_plane(what: str) -> None:
    disparity = np.full((SIZE[1], SIZE[0]), np.nan if what == "nothing" else 30.0, np.float32)
    rng = np.random.default_rng(2)
    if what == "noise":
        disparity = rng.uniform(1, 90, disparity.shape).astype(np.float32)
    assert road_plane(disparity, rig(), rng) is None


def test_a_body_that_rolls_in_bends_is_taken_to_rest() -> None:
    rng = np.random.default_rng(3)
    pushed = rng.uniform(0, 2, (60, 2))
    planes: list[GroundPlane | None] = []
    for along, left in pushed:
        mount = Mounting(
            0, 0, 1.4, TRUE.roll_rad + 0.008 * left, TRUE.pitch_rad - 0.005 * along, 0.0
        )
        planes.append(GroundPlane(-mount.rotation()[2], 1.4, 1.0))
    planes[7] = None
    found = ground_mounting(np.arange(60.0), planes, pushed)
    assert found is not None
    assert found.pitch_rad == pytest.approx(TRUE.pitch_rad, abs=1e-4)
    assert found.roll_rad == pytest.approx(TRUE.roll_rad, abs=1e-4)
    assert found.frames == (59, 60)
    assert ground_mounting(np.arange(4.0), planes[:4]) is None


def camera_truth(stamps: np.ndarray, mount: Mounting) -> CameraSteps:
    """Steps of the camera of a car that moves as `motion` says."""
    poses, _, _ = motion(stamps)
    r, lever = mount.rotation(), np.array([mount.x_m, mount.y_m, mount.z_m])
    cameras = []
    for x, y, yaw in poses:
        turn = rotation_from_angles(yaw, 0.0, 0.0)
        cameras.append((turn @ r, np.array([x, y, 0.0]) + turn @ lever))
    moved = [a[0].T @ (b[1] - a[1]) for a, b in pairwise(cameras)]
    turned = [a[0].T @ b[0] for a, b in pairwise(cameras)]
    return CameraSteps(stamps[:-1], stamps[1:], np.array(moved), np.array(turned))


def test_straight_driving_gives_the_yaw() -> None:
    steps = camera_truth(0.1 * np.arange(150), TRUE)
    stated = Mounting(TRUE.x_m, TRUE.y_m, TRUE.z_m, TRUE.roll_rad, TRUE.pitch_rad, 0.03)
    found = heading(steps, stated)
    assert found is not None
    assert found.yaw_rad == pytest.approx(TRUE.yaw_rad, abs=2e-4)
    assert found.pitch_rad == pytest.approx(TRUE.pitch_rad, abs=2e-4)
    standing = CameraSteps(steps.from_s, steps.to_s, 0 * steps.moved_m, steps.turned)
    assert heading(standing, stated) is None


def drive_of(odometry: OdometryStream) -> Drive:
    return Drive("made", Path("made"), EarthFrame("local", name="made"), 2.7, odometry=odometry)


@pytest.mark.parametrize("delay", [0.1, -0.25, 0.0])
def test_scale_and_delay_against_the_camera(delay: float) -> None:
    at = np.arange(0.0, 15.0, 0.02)
    _, speed, rate = motion(at)
    drive = drive_of(OdometryStream(at + delay, at + delay, 1.03 * speed, 0.98 * rate + 0.002))
    witness = of_camera(camera_truth(0.1 * np.arange(5, 140), TRUE), TRUE)
    assert witness is not None
    found = odometry_errors(drive, witness)
    assert found is not None
    assert found.speed_scale == pytest.approx(1.03, abs=5e-4)
    assert found.delay_s == pytest.approx(delay, abs=0.002)


@pytest.mark.parametrize("factor", [-1.0, 3.6, 0.278])
def test_odometry_of_another_unit_or_sign_is_no_scale_to_take_over(factor: float) -> None:
    at = np.arange(0.0, 15.0, 0.02)
    poses, speed, rate = motion(at)
    drive = drive_of(OdometryStream(at, at, factor * speed, rate))
    drive = replace(drive, reference=ReferenceStream(at, poses, np.full(len(at), 0.02)))
    quantities: list[Quantity] = []
    missing: list[str] = []
    assert _odometry(drive, None, quantities, missing) == []
    assert quantities == []
    assert any("no wheel's scale" in reason for reason in missing)


def test_a_steady_drive_knows_its_scale_but_no_delay() -> None:
    at = np.arange(0.0, 30.0, 0.02)
    rng = np.random.default_rng(4)
    noise = 0.02 * rng.standard_normal(len(at))
    drive = drive_of(OdometryStream(at, at, 8.0 + noise, 0.1 * noise))
    span = np.arange(1.0, 28.0, 0.5)
    witness = Witness("the camera", span, span + 0.5, np.full(54, 4.0) + 0.002 *
                      rng.standard_normal(54), 1e-4 * rng.standard_normal(54), 0.003)  # fmt: skip
    found = odometry_errors(drive, witness)
    assert found is not None
    assert found.speed_scale == pytest.approx(1.0, abs=0.005)
    assert np.isnan(found.delay_s)


def test_streams_that_do_not_meet_tell_nothing() -> None:
    at = np.arange(0.0, 30.0, 0.02)
    drive = drive_of(OdometryStream(at, at, np.full(len(at), 8.0), np.zeros(len(at))))
    span = np.arange(1000.0, 1030.0, 0.5)
    far = Witness("the camera", span, span + 0.5, np.full(60, 4.0), np.zeros(60), 0.003)
    assert odometry_errors(drive, far) is None
