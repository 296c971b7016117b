"""A small drive, made fresh, that tests write, damage and read."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections, VisibleRegion, pole_detections
from polemap.drivelog.drive import Drive, Lap
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.streams import GnssStream, OdometryStream, ReferenceStream
from polemap.drivelog.writers.folder import folder_writer
from polemap.stereo.rig import Mounting, StereoRig

RIG = StereoRig(64, 48, 80.0, 31.5, 23.5, 0.3, Mounting(1.9, 0.1, 1.3, 0.01, 0.02, -0.03))
VIEW = VisibleRegion(np.array([1.0, 0.0]), -0.8, 0.8, 2.0, np.array([30.0]))


def picture(seed: int, dtype: type = np.uint8) -> NDArray[np.uint8] | NDArray[np.uint16]:
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, (48, 64)).astype(dtype)


def streams(n: int = 40) -> tuple[OdometryStream, GnssStream, ReferenceStream]:
    """A car on a circle at 10 Hz, in UTM coordinates."""
    t = 100.0 + 0.1 * np.arange(n, dtype=np.float64)
    yaw = 0.1 * np.arange(n, dtype=np.float64) * 0.2 - 0.5
    east, north = 458000.0 + 50 * np.sin(yaw), 5.43e6 - 50 * np.cos(yaw)
    return (
        OdometryStream(t, t + 0.01, np.full(n, 10.0), np.full(n, 0.2)),
        GnssStream(t[::5], t[::5] + 0.2, east[::5], north[::5], np.full(len(t[::5]), 1.5)),
        ReferenceStream(t, np.column_stack([east, north, yaw]), np.full(n, 0.05)),
    )


def scan(stamp_s: float, points: list[tuple[float, float]]) -> Detections:
    n = len(points)
    return pole_detections(
        stamp_s,
        stamp_s + 0.05,
        np.array(points, dtype=np.float64).reshape(-1, 2),
        np.tile(np.array([[0.04, 0.01], [0.01, 0.02]]), (n, 1, 1)),
        width_m=np.full(n, 0.25),
        view=VIEW,
    )


def write_small(
    path: Path, *, frame: EarthFrame | None = None, images: int = 3, dtype: type = np.uint8
) -> Path:
    """A drive folder with every kind of sensor."""
    odometry, gnss, reference = streams()
    with folder_writer(
        path,
        name="small",
        frame=frame or EarthFrame("utm", 32632),
        wheelbase_m=2.7,
        rig=RIG if images else None,
        gnss_antenna_m=np.array([0.5, -0.2]),
        pole_view=VIEW,
        notes=("made for a test",),
    ) as writer:
        for i in range(images):
            left, right = picture(2 * i, dtype), picture(2 * i + 1, dtype)
            writer.frame(100.0 + 0.3 * i, 100.1 + 0.3 * i, left, right)
        writer.odometry(odometry)
        writer.gnss(gnss)
        writer.reference(reference)
        writer.scans([scan(100.05, [(10.0, 2.0), (12.0, -3.0)]), scan(100.25, [])])
        writer.laps([Lap("one", 100.0, 102.0), Lap("two", 102.0, 104.0)])
    return path


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text, f"{old!r} is not in {path}"
    path.write_text(text.replace(old, new, 1))


def png(path: Path, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), image)


__all__ = ["RIG", "VIEW", "Drive", "edit", "picture", "png", "scan", "streams", "write_small"]
