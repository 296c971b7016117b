"""The camera's stated height against the road that it sees, for the plausibility check."""

from __future__ import annotations

import numpy as np

from polemap.calibration.check import spread_rows
from polemap.calibration.ground import ground_planes
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import PolemapError
from polemap.drivelog.findings import Finding
from polemap.stereo.config import StereoConfig

_FRAMES, _PLANES_MIN = 5, 3
# KITTI within 2 %; simulated, small pictures of a narrow view up to 15 % higher
_DOUBT, _WRONG = 1.25, 1.6
# planes that belong to one height: the others saw a kerb, a car, the end of the road
_ALIKE, _ALIKE_SHARE = 1.12, 0.6


def height_findings(drive: Drive) -> list[Finding]:
    """A camera that stands higher or lower over the road than stated, from a handful of frames."""
    rig = drive.rig
    if rig is None or not drive.has_frames or not rig.vehicle_from_camera.z_m > 0.0:
        return []
    rows = spread_rows(drive, _FRAMES, straight=True)
    try:
        planes = ground_planes(drive, rows, StereoConfig(), seed=0)
    except PolemapError:
        # a picture that cannot be read, or too small to match: said where it matters
        return []
    heights = np.array([plane.height_m for plane in planes if plane is not None])
    if len(heights) < _PLANES_MIN:
        return []
    seen, stated = float(np.median(heights)), rig.vehicle_from_camera.z_m
    alike = np.abs(np.log(heights / seen)) < np.log(_ALIKE)
    off = abs(np.log(seen / stated))
    if off < np.log(_DOUBT) or alike.sum() < max(_PLANES_MIN, _ALIKE_SHARE * len(heights)):
        return []
    return [
        Finding(
            "camera_height", "error" if off > np.log(_WRONG) else "warning", "camera",
            f"the road lies {seen:.2f} m below it in {alike.sum()} of {len(rows)} frames",
            f"z_m, {stated:g} m, within {100 * (_DOUBT - 1):.0f} %",
            "measure the camera's height over the ground (polemap calibrate finds it, too)",
        )
    ]  # fmt: skip
