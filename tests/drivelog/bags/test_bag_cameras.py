"""Calibrations and mountings of cameras in recordings."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.stereo.camera_info import camera_info, of_camera_infos
from polemap.stereo.rectify import Rectifier
from polemap.stereo.rig import Mounting
from tests.drivelog.bags.recordings import Said
from tests.drivelog.bags.streams import (
    CAMERA_AXES,
    MOUNTED,
    ROS,
    START_NS,
    STEP_NS,
    TF,
    Opened,
    infos,
    mountings,
    pair,
    pictures,
    sides_of,
    twists,
)
from tests.drivelog.drives import RIG, picture


def test_the_mounting_comes_over_a_chain_of_frames(opened: Opened) -> None:
    """base_footprint -> base_link (0.4 m up) -> camera (body axes: x ahead), and a moving one."""
    chain = mountings(
        ("base_footprint", "base_link", np.array([0.0, 0.0, 0.4]), np.eye(3)),
        ("base_link", "camera", np.array([1.5, 0.2, 1.0]), np.eye(3)),
    )
    moving = [
        Said(START_NS + row, "/tf", TF, ROS.transforms(
            ("odom", "base_footprint", np.array([float(row), 0.0, 0.0]), np.eye(3))))
        for row in range(3)
    ]  # fmt: skip
    drive = opened(pair(), chain, moving, vehicle={"rear_axle_x_m": -0.5})
    assert drive.rig is not None
    mount = drive.rig.vehicle_from_camera
    assert (mount.x_m, mount.y_m, mount.z_m) == pytest.approx((2.0, 0.2, 1.4))
    assert (mount.roll_rad, mount.pitch_rad, mount.yaw_rad) == pytest.approx((0.0, 0.0, 0.0))


def test_a_camera_without_a_place_is_an_error_and_a_mapping_places_it(opened: Opened) -> None:
    drive = opened(pair())
    (finding,) = (f for f in drive.findings if f.severity == "error")
    assert finding.kind == "camera_mounting"
    assert "'camera'" in finding.value
    place = {"x_m": 1.0, "y_m": 0.0, "z_m": 1.2, "pitch_rad": 0.1}
    drive = opened(pair(), camera=sides_of(vehicle_from_camera=place))
    assert not drive.findings
    assert drive.rig is not None
    assert drive.rig.vehicle_from_camera == Mounting(1.0, 0.0, 1.2, 0.0, 0.1, 0.0)


@pytest.mark.parametrize(
    ("left", "right", "reason"),
    [
        ({}, {"P": None}, "no calibration was recorded for the right pictures"),
        ({"K": np.zeros(9)}, {}, "is not calibrated"),
        ({"D": np.full(5, np.nan)}, {}, "finite"),
        ({"lens": "mystery"}, {}, "lens model 'mystery' is unknown"),
        ({"P": "right"}, {"P": "left"}, "exchange left and right"),
        ({}, {"P": "left"}, "neither P.0,3. nor TF tells the baseline"),
    ],
)
def test_calibrations_that_cannot_be_are_told(
    left: dict[str, Any], right: dict[str, Any], reason: str, opened: Opened
) -> None:
    parts = []
    for side, other in (("left", left), ("right", right)):
        parts.append(pictures(f"/stereo/{side}/image_rect"))
        if "P" in other and other["P"] is None:
            continue
        if isinstance(other.get("P"), str):
            other = {"P": ROS.info(0, RIG, other["P"]).p}
        parts.append(infos(f"/stereo/{side}/camera_info", side, **other))
    drive = opened(*parts, twists(), MOUNTED)
    assert not drive.has_frames
    assert drive.odometry is not None
    (finding,) = (f for f in drive.findings if f.kind == "camera_calibration")
    assert finding.severity == "error"
    assert re.search(reason, finding.value)


def test_tf_between_the_cameras_gives_the_baseline_of_two_single_ones(opened: Opened) -> None:
    """Drivers of single cameras leave P of both without a shift, or at zero."""
    parts = []
    for side in ("left", "right"):
        info = infos(f"/stereo/{side}/camera_info", side, P=np.zeros(12))
        info[0].content.header.frame_id = f"camera_{side}"
        parts += [pictures(f"/stereo/{side}/image_rect"), info]
    frames = mountings(
        ("base_link", "camera_left", np.array([1.0, 0.0, 1.0]), CAMERA_AXES),
        ("camera_left", "camera_right", np.array([0.25, 0.0, 0.0]), np.eye(3)),
    )
    drive = opened(*parts, frames)
    assert drive.rig is not None
    assert drive.rig.baseline_m == pytest.approx(0.25)


def test_raw_pairs_are_rectified_by_their_calibration(opened: Opened) -> None:
    lens = np.array([-0.2, 0.05, 0.001, -0.001, 0.0])
    drive = opened(pair(name="image_raw", D=lens), MOUNTED)
    found = [ROS.info(0, RIG, side, D=lens) for side in ("left", "right")]
    sides = [camera_info((64, 48), "plumb_bob", (one.k, one.d, one.r, one.p)) for one in found]
    wanted = Rectifier(of_camera_infos(*sides)).rectify(picture(2), picture(2))
    frame = drive.read_frame(2)
    np.testing.assert_array_equal(frame.left, wanted[0])
    np.testing.assert_array_equal(frame.right, wanted[1])
    assert not np.array_equal(frame.left, picture(2))
    # the same pictures under a name that says rectified are taken as they are
    named = opened(pair(name="image_rect", D=lens), MOUNTED)
    np.testing.assert_array_equal(named.read_frame(2).left, picture(2))


def test_pictures_of_another_size_than_their_calibration_are_told(opened: Opened) -> None:
    said = pair()
    odd = [ROS.image(START_NS + STEP_NS, np.zeros((40, 64), dtype=np.uint8))]
    said = [
        Said(one.log_ns, one.topic, one.type_name, odd[0])
        if one.topic.endswith("left/image_rect") and one.log_ns == START_NS + STEP_NS + 20_000_000
        else one
        for one in said
    ]
    drive = opened(said, MOUNTED)
    with pytest.raises(InputError, match="/stereo/left/image_rect, picture 1: 64x40 pixels"):
        drive.read_frame(1)
    drive.read_frame(2)
