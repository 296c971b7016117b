"""What calibration finds: quantities beside what the drive states, and where they contradict."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from polemap.calibration.ground import GroundPlane
from polemap.calibration.motion import CameraSteps
from polemap.calibration.odometry import OdometryErrors
from polemap.calibration.rows import RowAgreement
from polemap.drivelog.findings import Finding
from polemap.stereo.rig import Mounting

MOUNT = "camera.vehicle_from_camera."
# smaller differences change neither a map nor a pose
_NEGLIGIBLE = {
    f"{MOUNT}z_m": 0.03,
    f"{MOUNT}roll_rad": 0.01,
    f"{MOUNT}pitch_rad": 0.005,
    f"{MOUNT}yaw_rad": 0.004,
    "odometry.speed_scale": 0.005,
    "odometry.delay_s": 0.015,
}
_SIGNIFICANT = 3.0
_ROWS_PX, _ACROSS_PX, _YAW_PX = 0.5, 1.0, 0.5
# camera odometry keeps to a percent or two of a well calibrated pair
_SCALE = 0.02


@dataclass(frozen=True, slots=True)
class Quantity:
    """One number of a calibration.

    Attributes:
        name: where it stands in drive.yaml.
        stated: what the drive says.
        found, sd: what its pictures and streams say.
        source: how it was found.
    """

    name: str
    stated: float
    found: float
    sd: float
    source: str

    @property
    def contradicts(self) -> bool:
        """Whether the drive and its calibration disagree beyond chance and beyond notice."""
        limit = max(_SIGNIFICANT * self.sd, _NEGLIGIBLE[self.name])
        return bool(abs(self.found - self.stated) > limit)


@dataclass(frozen=True, slots=True)
class Calibration:
    """What was found, and what it was found from.

    Attributes:
        rows: agreement of the pair's rows, None without pictures.
        quantities: what could be estimated.
        missing: what could not, and why.
        odometry: against each witness; the first one is believed.
        planes: road per frame looked at, with `plane_rows` of the drive.
        steps: motion of the camera.
    """

    rows: RowAgreement | None
    quantities: tuple[Quantity, ...]
    missing: tuple[str, ...]
    odometry: tuple[OdometryErrors, ...]
    planes: tuple[GroundPlane | None, ...]
    plane_rows: tuple[int, ...]
    steps: CameraSteps | None

    def mounting(self, stated: Mounting) -> Mounting:
        """The stated mounting with what was found in its place."""
        found = {q.name.removeprefix(MOUNT): q.found for q in self.quantities
                 if q.name.startswith(MOUNT)}  # fmt: skip
        return replace(stated, **found)

    def camera_scale(self) -> tuple[float, float] | None:
        """What the camera says for a true metre, and its standard deviation.

        By way of the odometry, which both the reference and the camera were held against.
        """
        if len(self.odometry) < 2:
            return None
        true, seen = self.odometry[:2]
        scale = true.speed_scale / seen.speed_scale
        relative = np.hypot(
            true.speed_scale_sd / true.speed_scale, seen.speed_scale_sd / seen.speed_scale
        )
        return scale, float(scale * relative)

    def findings(self) -> list[Finding]:
        """Where the drive contradicts its calibration."""
        found = _row_findings(self.rows) if self.rows else []
        found += _scale_findings(self.camera_scale())
        for quantity in self.quantities:
            if quantity.contradicts:
                found.append(
                    Finding(
                        "calibration", "warning", quantity.name,
                        f"stated {quantity.stated:.4g}, found {quantity.found:.4g} +- "
                        f"{quantity.sd:.2g} ({quantity.source})",
                        f"the same within {_SIGNIFICANT:g} standard deviations",
                        "measure it again, or take over what was found",
                    )
                )  # fmt: skip
        return found


def _row_findings(rows: RowAgreement) -> list[Finding]:
    found = []
    if abs(rows.yaw_px) > _YAW_PX and abs(rows.yaw_rad) > _SIGNIFICANT * rows.yaw_sd_rad:
        found.append(
            Finding(
                "rectification", "warning", "camera",
                f"the rows have the keystone of a right camera turned by "
                f"{np.degrees(rows.yaw_rad):.3f} +- {np.degrees(rows.yaw_sd_rad):.3f} degrees: "
                f"disparities are off by {abs(rows.yaw_px):.1f} px, or if its principal point "
                "makes up for that in the middle, towards the edges",
                f"{_YAW_PX:g} px at most", "calibrate the pair again",
            )
        )  # fmt: skip
    if abs(rows.median_px) <= _ROWS_PX and not rows.across_px > _ACROSS_PX:
        return found
    found.append(
        Finding(
            "rectification", "warning", "camera",
            f"rows differ by {rows.median_px:.2f} px in the median and by {rows.across_px:.1f} px "
            "between parts of the picture",
            f"{_ROWS_PX:g} px and {_ACROSS_PX:g} px at most", "calibrate the pair again",
        )
    )  # fmt: skip
    return found


def _scale_findings(scale: tuple[float, float] | None) -> list[Finding]:
    if scale is None or abs(scale[0] - 1.0) <= max(_SIGNIFICANT * scale[1], _SCALE):
        return []
    return [
        Finding(
            "camera_scale", "warning", "camera",
            f"its ways are {scale[0]:.3f} +- {scale[1]:.3f} times those of the reference",
            f"the same within {100 * _SCALE:g} %",
            "measure baseline and focal length, and calibrate the yaw of the right camera again: "
            "distances, height and pitch are wrong with them",
        )
    ]  # fmt: skip
