"""Where the cameras of a rig stand in the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.stereo.rig import StereoRig

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CameraPose:
    """A camera in the world: rotation `(3, 3)` world from camera axes, position `(3,)` metres."""

    rotation: Floats
    position_m: Floats


def camera_poses(
    rig: StereoRig,
    vehicle_position_m: Floats,
    vehicle_rotation: Floats,
    right_tilt: Floats | None = None,
) -> tuple[CameraPose, CameraPose]:
    """Both cameras of a vehicle; `right_tilt` `(3, 3)` turns the right camera out of true."""
    mount = rig.vehicle_from_camera
    rotation = vehicle_rotation @ mount.rotation()
    origin = vehicle_position_m + vehicle_rotation @ np.array([mount.x_m, mount.y_m, mount.z_m])
    beside = origin + rotation @ np.array([rig.baseline_m, 0.0, 0.0])
    turned = rotation if right_tilt is None else rotation @ right_tilt
    return CameraPose(rotation, origin), CameraPose(turned, beside)
