"""The stereo rig of a recording: calibrations of both cameras, mounting by TF or mapping."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.findings import Finding
from polemap.drivelog.readers.bags.index import LogIndex, Topic
from polemap.drivelog.readers.bags.mapping import CameraPart
from polemap.drivelog.readers.bags.vehicle_frame import VehicleFrame
from polemap.drivelog.readers.kitti import VEHICLE_FROM_CAMERA_AXES, mounting
from polemap.stereo.rig import Mounting, StereoRig

Floats = NDArray[np.float64]

# what differs by less than this between raw and rectified is no distortion a picture could show
_SAME_PX = 0.01
_ASSUMED_HEIGHT_M = 1.5


@dataclass(frozen=True, slots=True)
class CameraModel:
    """One calibration message.

    Attributes:
        matrix: `(3, 3)` K of the raw pictures.
        lens: name of the distortion model.
        coefficients: D.
        rotation: `(3, 3)` R, rectified from raw axes.
        projection: `(3, 4)` P of the rectified pictures.
    """

    frame_id: str
    width_px: int
    height_px: int
    matrix: Floats
    lens: str
    coefficients: Floats
    rotation: Floats
    projection: Floats

    @property
    def is_rectified(self) -> bool:
        """Whether raw pictures are rectified ones: no lens, no rotation, the same pinhole."""
        return (
            not np.any(self.coefficients)
            and bool(np.allclose(self.rotation, np.eye(3), atol=1e-9))
            and bool(np.allclose(self.matrix, self.projection[:, :3], atol=_SAME_PX))
        )


def camera_model(topic: Topic) -> CameraModel:
    """The calibration that a topic states.

    Raises:
        InputError: it is not calibrated, or holds something else than numbers.
    """
    message = topic.first
    if message is None:
        raise InputError(f"{topic.name}: holds no calibration that can be read")

    def numbers(name: str) -> Floats:
        values = getattr(message, name.lower(), getattr(message, name, ()))
        return np.array([float(value) for value in values], dtype=np.float64)

    matrix, projection, turn = numbers("K"), numbers("P"), numbers("R")
    if matrix.size != 9 or not matrix[0] > 0:
        raise InputError(f"{topic.name}: is not calibrated (K is {matrix[:3].tolist()}…)")
    if projection.size != 12 or not projection[0] > 0:  # monocular drivers leave P at zero
        projection = np.hstack([matrix.reshape(3, 3), np.zeros((3, 1))]).ravel()
    if turn.size != 9 or not np.any(turn):
        turn = np.eye(3).ravel()
    everything = np.concatenate([matrix, projection, turn, numbers("D")])
    if not np.isfinite(everything).all():
        raise InputError(f"{topic.name}: holds numbers that are not finite")
    return CameraModel(
        topic.frame_id,
        int(message.width),
        int(message.height),
        matrix.reshape(3, 3),
        str(message.distortion_model),
        numbers("D"),
        turn.reshape(3, 3),
        projection.reshape(3, 4),
    )


def stereo_rig(
    index: LogIndex, part: CameraPart, vehicle: VehicleFrame, findings: list[Finding]
) -> StereoRig:
    """The rig of a pair of rectified pictures.

    Raises:
        InputError: a calibration is missing or is none, the two do not fit each other, or the
            pictures have to be rectified first.
    """
    left, right = (
        camera_model(_info(index, side, getattr(part, side).info)) for side in ("left", "right")
    )
    named = "rect" in part.left.image.lower() and "unrect" not in part.left.image.lower()
    rectified = part.rectified if part.rectified is not None else named
    if not rectified and not (left.is_rectified and right.is_rectified):
        raise InputError(
            f"{part.left.image}: raw pictures of a lens ({left.lens}); record the rectified topic, "
            "or set camera.rectified: true in a mapping if they are"
        )
    if (left.width_px, left.height_px) != (right.width_px, right.height_px):
        raise InputError(
            f"{part.right.info}: {right.width_px}x{right.height_px} pixels, the left camera has "
            f"{left.width_px}x{left.height_px}: a pair needs one size"
        )
    focal = left.projection[0, 0]
    if abs(right.projection[0, 0] - focal) > 1e-3 * focal:
        raise InputError(
            f"{part.right.info}: focal length {right.projection[0, 0]:.2f} px, that of the left "
            f"camera is {focal:.2f}: these are not the projections of a rectified pair"
        )
    return StereoRig(
        left.width_px,
        left.height_px,
        float(focal),
        float(left.projection[0, 2]),
        float(left.projection[1, 2]),
        baseline_m(left, right, part, vehicle),
        vehicle_from_camera(left, part, vehicle, findings),
    )


def _info(index: LogIndex, side: str, name: str | None) -> Topic:
    if name is None:
        raise InputError(
            f"no calibration was recorded for the {side} pictures (a CameraInfo or "
            f"CameraCalibration topic beside them); name it as camera.{side}.info in a mapping"
        )
    return index.topics[name]


def baseline_m(
    left: CameraModel, right: CameraModel, part: CameraPart, vehicle: VehicleFrame
) -> float:
    """From the mapping, from the projections (P[0, 3] = -f b), or from TF between the cameras.

    Raises:
        InputError: none of them says it, or the right camera does not stand to the right.
    """
    if part.baseline_m is not None:
        return part.baseline_m
    focal = float(left.projection[0, 0])
    baseline = float(left.projection[0, 3] - right.projection[0, 3]) / focal
    if baseline == 0.0:
        way = vehicle.tree.fixed(left.frame_id, right.frame_id)
        baseline = float(way[0, 3]) if way is not None else 0.0
    if baseline < 0.0:
        raise InputError(
            f"{part.right.image}: its calibration puts it {-baseline:.3f} m to the left of "
            f"{part.left.image}: exchange left and right in a mapping"
        )
    if baseline == 0.0:
        raise InputError(
            f"{part.right.info}: neither P[0,3] nor TF tells the baseline; set camera.baseline_m "
            "in a mapping"
        )
    return baseline


def vehicle_from_camera(
    left: CameraModel, part: CameraPart, vehicle: VehicleFrame, findings: list[Finding]
) -> Mounting:
    """The mounting of the left camera; an assumed one is an error among the findings."""
    given = part.vehicle_from_camera
    if given is not None:
        return Mounting(
            given.x_m, given.y_m, given.z_m, given.roll_rad, given.pitch_rad, given.yaw_rad
        )
    way = vehicle.vehicle_from(left.frame_id)
    if way is None:
        findings.append(
            Finding(
                "camera_mounting",
                "error",
                part.left.image,
                f"no fixed TF leads from the car ({vehicle.base or 'no such frame'}) to "
                f"'{left.frame_id}'",
                "the camera's place in the car",
                "set camera.vehicle_from_camera in a mapping (--topics); taken for now: 1.5 m "
                "above the rear axle, looking ahead",
            )
        )
        return Mounting(z_m=_ASSUMED_HEIGHT_M)
    rotation = way[:3, :3]
    # optical frames look along z; a frame of the camera's body has x ahead and z up
    if abs(rotation[2, 2]) > 0.7 and abs(rotation[2, 1]) < 0.7:
        rotation = rotation @ VEHICLE_FROM_CAMERA_AXES
    return mounting(rotation, way[:3, 3])
