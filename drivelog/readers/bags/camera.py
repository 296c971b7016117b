"""The stereo camera of a recording: calibrations of both sides, mounting by TF or mapping."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.findings import Finding
from polemap.drivelog.readers.bags.index import LogIndex, Topic
from polemap.drivelog.readers.bags.mapping import CameraPart
from polemap.drivelog.readers.bags.vehicle_frame import VehicleFrame
from polemap.stereo.camera_info import CameraInfo, camera_info, of_camera_infos
from polemap.stereo.errors import StereoError
from polemap.stereo.rectify import Rectifier
from polemap.stereo.rig import Mounting, StereoRig

Floats = NDArray[np.float64]

# what differs by less than this between raw and rectified is no distortion a picture could show
_SAME_PX = 0.01
_ASSUMED_HEIGHT_M = 1.5
_DECIMALS = 12
# of a camera's body (x ahead, y left, z up), the axes of its optical frame (z ahead, x right)
_BODY_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def stated_camera(topic: Topic) -> CameraInfo:
    """The calibration that a topic states; what a driver leaves at zero is filled in.

    Raises:
        InputError: it is not calibrated, or holds something else than numbers.
    """
    message = topic.first
    if message is None:
        raise InputError(f"{topic.name}: holds no calibration that can be read")

    def numbers(name: str) -> Floats:
        values = getattr(message, name.lower(), getattr(message, name, ()))
        return np.array([float(value) for value in values], dtype=np.float64)

    k, d, r, p = (numbers(name) for name in "KDRP")
    if k.size != 9 or not k[0] > 0:
        raise InputError(f"{topic.name}: is not calibrated (its K is {k[:3].tolist()}…)")
    if p.size != 12 or not p[0] > 0:  # drivers of single cameras leave P at zero
        p = np.hstack([k.reshape(3, 3), np.zeros((3, 1))]).ravel()
    if r.size != 9 or not np.any(r):
        r = np.eye(3).ravel()
    size = int(message.width), int(message.height)
    try:
        return camera_info(size, str(message.distortion_model), (k, d, r, p))
    except StereoError as error:
        raise InputError(f"{topic.name}: {error}") from error


def is_rectified(side: CameraInfo) -> bool:
    """Whether raw pictures are rectified ones: no lens, no rotation, the same pinhole."""
    return (
        not side.camera.has_distortion
        and bool(np.allclose(side.rectification, np.eye(3), atol=1e-9))
        and bool(np.allclose(side.camera.matrix, side.projection[:, :3], atol=_SAME_PX))
    )


def stereo_camera(
    index: LogIndex, part: CameraPart, vehicle: VehicleFrame, findings: list[Finding]
) -> tuple[StereoRig, Rectifier | None]:
    """The rectified rig, and what makes rectified pictures of raw ones where they are raw.

    Raises:
        InputError: a calibration is missing or is none, or the two do not fit each other.
    """
    topics = [_info(index, side, getattr(part, side).info) for side in ("left", "right")]
    left, right = (stated_camera(topic) for topic in topics)
    named = "rect" in part.left.image.lower() and "unrect" not in part.left.image.lower()
    rectified = part.rectified if part.rectified is not None else named
    rectified = rectified or (is_rectified(left) and is_rectified(right))
    baseline = baseline_m((left, right), topics, part, vehicle)
    # TF knows the axes of the raw camera
    turn = np.eye(3) if rectified else left.rectification.T
    mount = vehicle_from_camera(topics[0].frame_id, turn, part, vehicle, findings)
    try:
        shifted = right.projection.copy()
        shifted[0, 3] = left.projection[0, 3] - left.projection[0, 0] * baseline
        pair = of_camera_infos(left, CameraInfo(right.camera, right.rectification, shifted))
        rectifier = Rectifier(pair, mount)
    except StereoError as error:
        raise InputError(f"{part.left.info} and {part.right.info}: {error}") from error
    return rectifier.rig, None if rectified else rectifier


def _info(index: LogIndex, side: str, name: str | None) -> Topic:
    if name is None:
        raise InputError(
            f"no calibration was recorded for the {side} pictures (a CameraInfo or "
            f"CameraCalibration topic beside them); name it as camera.{side}.info in a mapping"
        )
    return index.topics[name]


def baseline_m(
    sides: tuple[CameraInfo, CameraInfo],
    topics: list[Topic],
    part: CameraPart,
    vehicle: VehicleFrame,
) -> float:
    """From the mapping, from the projections (P[0, 3] = -f b), or from TF between the cameras.

    Raises:
        InputError: none of them says it, or the right camera does not stand to the right.
    """
    if part.baseline_m is not None:
        return part.baseline_m
    left, right = (side.projection for side in sides)
    baseline = float((left[0, 3] - right[0, 3]) / left[0, 0])
    if baseline == 0.0:
        way = vehicle.tree.fixed(topics[0].frame_id, topics[1].frame_id)
        baseline = float(way[0, 3]) if way is not None else 0.0
    if baseline < 0.0:
        raise InputError(
            f"{part.right.image}: its calibration puts it {-baseline:.3f} m to the left of "
            f"{part.left.image}: exchange left and right in a mapping"
        )
    if baseline == 0.0:
        raise InputError(
            f"{topics[1].name}: neither P[0,3] nor TF tells the baseline; set camera.baseline_m "
            "in a mapping"
        )
    return baseline


def vehicle_from_camera(
    frame_id: str,
    turn: Floats,
    part: CameraPart,
    vehicle: VehicleFrame,
    findings: list[Finding],
) -> Mounting:
    """The mounting of the rectified left camera; an assumed one is an error among the findings.

    Args:
        frame_id: of the left camera.
        turn: `(3, 3)` axes of `frame_id` from rectified axes.
        part: what the mapping says.
        vehicle: the car's frame.
        findings: to be added to.
    """
    given = part.vehicle_from_camera
    if given is not None:
        return Mounting(
            given.x_m, given.y_m, given.z_m, given.roll_rad, given.pitch_rad, given.yaw_rad
        )
    way = vehicle.vehicle_from(frame_id)
    if way is None:
        findings.append(
            Finding(
                "camera_mounting",
                "error",
                part.left.image,
                f"no fixed TF leads from the car ({vehicle.base or 'no such frame'}) to "
                f"'{frame_id}'",
                "the camera's place in the car",
                "set camera.vehicle_from_camera in a mapping (--topics); taken for now: "
                f"{_ASSUMED_HEIGHT_M} m above the rear axle, looking ahead",
            )
        )
        return Mounting(z_m=_ASSUMED_HEIGHT_M)
    rotation = way[:3, :3]
    # an optical frame looks along z; z of a camera's body points up
    if abs(rotation[2, 2]) > 0.7:
        rotation = rotation @ _BODY_FROM_OPTICAL
    mount = Mounting.from_rotation(rotation @ turn, way[:3, 3])
    # quaternions leave 1e-16 behind, which the building of a map would make visible
    return Mounting(*(round(value, _DECIMALS) for value in astuple(mount)))
