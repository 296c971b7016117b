"""A drive as an MCAP file of ROS 2 messages, which polemap, ROS 2 and Foxglove read.

| topic | type | what of the drive |
|---|---|---|
| `/stereo/left/image_rect/compressed`, `.../right/...` | CompressedImage (PNG, lossless) | images |
| `/stereo/left/camera_info`, `/stereo/right/camera_info` | CameraInfo | calibration |
| `/vehicle/twist` | TwistStamped | odometry |
| `/gnss/fix` | NavSatFix | fixes in a utm frame |
| `/gnss/position` | PoseWithCovarianceStamped | fixes in a local frame |
| `/reference` | Odometry | reference poses |
| `/poles` | polemap_msgs/PoleScan (defined in the file) | poles detected elsewhere |
| `/tf_static` | TFMessage | mounting of camera and antenna |

Header stamps are when a sample was measured, log times when it arrived. What no message holds
(wheelbase, earth frame, laps, car file, notes) is attached as `drive.yaml`, `laps.csv` and
`car.yaml`, as in a plain drive folder.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.detections import Detections, pole_view
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import geographic_from_grid
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.readers.bags.described import (
    FIX,
    POLES,
    POSITION,
    REFERENCE,
    SIDES,
    TWIST,
    image_topic,
    info_topic,
)
from polemap.drivelog.samples import GnssFix, OdometrySample, ReferencePose, Sample, StereoFrame
from polemap.drivelog.streams import SD_AT_DILUTION_ONE_M
from polemap.drivelog.writers.folder import CAR_FILE, drive_head, laps_text
from polemap.drivelog.writers.ros import messages as ros
from polemap.drivelog.writers.ros.mcap_file import McapFile, mcap_file
from polemap.stereo.rig import StereoRig
from polemap.vehicle.io import dump_car

Floats = NDArray[np.float64]

CAMERAS = {"left": ros.LEFT_CAMERA, "right": ros.RIGHT_CAMERA}


def write_drive_mcap(
    drive: Drive, path: Path, advance: Callable[[int], None] | None = None
) -> dict[str, int]:
    """Write any drive as one MCAP file; images are read and written one pair at a time.

    Args:
        advance: called with 1 after every pair of pictures.

    Returns:
        Messages by topic.

    Raises:
        InputError: stamps before zero, an image that cannot be read, a lap's name that no table
            holds.
        MissingExtraError: mcap or rosbags is not installed.
    """
    with atomic_file(path, (drive.path,)) as part, mcap_file(part) as file:
        _attach_description(file, drive)
        writer = _SampleWriter(file, drive)
        for sample in drive.samples():
            writer.write(sample)
            if advance is not None and isinstance(sample, StereoFrame):
                advance(1)
    return file.counts


def description(drive: Drive) -> dict[str, bytes]:
    """Files of a plain drive folder that say what no message holds, by their names."""
    head = drive_head(
        name=drive.name,
        frame=drive.frame,
        wheelbase_m=drive.wheelbase_m,
        car_file=CAR_FILE if drive.car is not None else None,
        rig=drive.rig,
        gnss_antenna_m=drive.gnss_antenna_m,
        pole_view=pole_view(drive.scans),
        notes=drive.notes,
    )
    texts = {"drive.yaml": yaml.safe_dump(head, sort_keys=False, allow_unicode=True)}
    if drive.car is not None:
        texts[CAR_FILE] = dump_car(drive.car)
    if drive.laps:
        texts["laps.csv"] = laps_text(drive.laps)
    return {name: text.encode("utf-8") for name, text in texts.items()}


def _attach_description(file: McapFile, drive: Drive) -> None:
    for name, content in description(drive).items():
        file.attach(name, "text/csv" if name.endswith(".csv") else "application/yaml", content)


class _SampleWriter:
    """Turns samples into messages on their topics."""

    def __init__(self, file: McapFile, drive: Drive) -> None:
        self._file, self._drive = file, drive
        self._frame = f"utm_{drive.frame.epsg}" if drive.frame.is_utm else ros.MAP
        self._begun = False

    def write(self, sample: Sample) -> None:
        """Append what a sample says."""
        log_s, stamp_s = sample.arrival_s, sample.stamp_s
        if not self._begun:
            self._begun = True
            self._mounting(log_s)
        if isinstance(sample, StereoFrame):
            self._pair(sample)
        elif (
            isinstance(sample, Detections) and sample.view is not None and sample.view.sees_nothing
        ):
            return  # it looked for lines alone
        else:
            topic, message = self._of(sample)
            self._file.write(topic, message, log_s, stamp_s)

    def _of(self, sample: OdometrySample | GnssFix | ReferencePose | Detections) -> tuple[str, Any]:
        if isinstance(sample, OdometrySample):
            return TWIST, ros.twist(sample)
        if isinstance(sample, GnssFix):
            return self._fix(sample)
        if isinstance(sample, Detections):
            # of another kind it would be read as a pole
            return POLES, ros.pole_scan(sample.of_kinds(LandmarkKind.POLE))
        known = np.isfinite(sample.sd_m)
        covariance = np.diag([sample.sd_m**2, sample.sd_m**2, 0.0]) if known else None
        place = np.array(sample.pose)
        return REFERENCE, ros.odometry(sample.stamp_s, self._frame, place, covariance)

    def _fix(self, fix: GnssFix) -> tuple[str, Any]:
        sd_m = SD_AT_DILUTION_ONE_M * fix.hdop
        if not self._drive.frame.is_utm:
            place = np.array([fix.east_m, fix.north_m, 0.0])
            covariance = np.diag([sd_m**2, sd_m**2, 0.0])
            return POSITION, ros.stamped_pose_with_covariance(
                fix.stamp_s, self._frame, place, covariance
            )
        latitude, longitude = geographic_from_grid(
            self._drive.frame, np.array([[fix.east_m, fix.north_m]])
        )[0]
        return FIX, ros.nav_sat_fix(fix.stamp_s, latitude, longitude, sd_m)

    def _pair(self, frame: StereoFrame) -> None:
        rig = self._drive.rig
        if rig is None:
            raise InputError(f"drive {self._drive.name}: it has images but no camera")
        for side, image in zip(SIDES, (frame.left, frame.right), strict=True):
            done, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
            if not done:
                raise InputError(f"image {image.shape} {image.dtype} cannot be encoded")
            picture = ros.compressed_image(frame.stamp_s, CAMERAS[side], "png", data.tobytes())
            about = ros.camera_info(rig, frame.stamp_s, right=side == "right")
            self._file.write(info_topic(side), about, frame.arrival_s, frame.stamp_s)
            self._file.write(image_topic(side), picture, frame.arrival_s, frame.stamp_s)

    def _mounting(self, log_s: float) -> None:
        antenna = (*map(float, self._drive.gnss_antenna_m), 0.0)
        placed = [ros.transform(log_s, ros.VEHICLE, "gnss", antenna, np.eye(3))]
        rig: StereoRig | None = self._drive.rig
        if rig is not None:
            placed += ros.camera_transforms(rig, log_s)
        self._file.write("/tf_static", ros.transforms(placed), log_s)
