"""Some pictures of the drive with what the eye saw in them, for the report's page."""

from __future__ import annotations

import base64
from dataclasses import dataclass

import cv2
import numpy as np

from polemap.drivelog.drive import Drive
from polemap.errors import PolemapError
from polemap.evaluation.results import RouteResult
from polemap.map.pole_map import PoleMap
from polemap.perception import PolePerception
from polemap.settings import Settings
from polemap.tools.detect_pictures import overlay
from polemap.vehicle.pose import inverse_transform_points
from polemap.vehicle.trajectory import Trajectory

# at these shares of the drive: away from its start, where many stand
_SHARES = (0.3, 0.6, 0.9)
_WIDTH_PX, _QUALITY = 1000, 72
_MAPPED_WITHIN_M = 40.0


@dataclass(frozen=True, slots=True)
class Photo:
    """A picture as a file of the report and as a `data:` address for its page."""

    key: str
    caption: str
    jpeg: bytes

    @property
    def address(self) -> str:
        """What an `img` element takes."""
        return "data:image/jpeg;base64," + base64.b64encode(self.jpeg).decode("ascii")


def route_photos(result: RouteResult, slug: str) -> tuple[Photo, ...]:
    """Three pictures of the route's first drive that has any; none where they cannot be read."""
    for recording in result.route.recordings:
        drive = recording.drive
        if drive is not None and drive.has_frames and drive.rig is not None:
            return tuple(
                photo
                for share in _SHARES
                if (photo := _photo(drive, recording.guide, result.route.pole_map, share, slug))
            )
    return ()


def _photo(
    drive: Drive, guide: Trajectory, pole_map: PoleMap | None, share: float, slug: str
) -> Photo | None:
    """The picture nearest to a share of the localized time; each is looked at by itself."""
    begin, end = float(guide.stamp_s[0]), float(guide.stamp_s[-1])
    row = int(np.argmin(np.abs(drive.frame_stamps_s - (begin + share * (end - begin)))))
    settings = Settings()
    try:
        frame = drive.read_frame(row)
        perception = PolePerception(drive.rig, settings.polemap, stereo=settings.stereo)
        perceived = perception.perceive(frame)
    except PolemapError:
        return None  # the drive has changed since; the rest of the report stands
    pose = guide.at([frame.stamp_s])[0]
    mapped = None
    if pole_map is not None and np.isfinite(pose).all():
        near = pole_map.within(pose[:2], _MAPPED_WITHIN_M)
        mapped = inverse_transform_points(pose, pole_map.points_m[near])
    picture = overlay(perceived, settings.polemap.detection.probability_min, mapped)
    height = round(picture.shape[0] * _WIDTH_PX / picture.shape[1])
    small = cv2.resize(picture, (_WIDTH_PX, height), interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if not done:
        return None
    when = f"{frame.stamp_s - begin:.1f} s after the first pose"
    return Photo(f"{slug}-seen-{round(100 * share)}", when, data.tobytes())
