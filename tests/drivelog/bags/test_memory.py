"""Pictures are not kept: memory does not grow with their number."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.readers.registry import open_drive
from tests.drivelog.bags.recordings import Ros, Said, write_mcap, write_rosbag2
from tests.drivelog.drives import RIG

HEIGHT, WIDTH = 120, 500


def pictures(count: int) -> list[Said]:
    ros, said = Ros(), []
    pixels = np.random.default_rng(2).integers(0, 255, (HEIGHT, WIDTH)).astype(np.uint8)
    for number in range(count):
        now = 10**9 * (1000 + number)
        for side in ("left", "right"):
            image = ros.image(now, pixels)
            said.append(Said(now, f"/{side}/image_rect", "sensor_msgs/msg/Image", image))
        if not number:
            for side in ("left", "right"):
                info = ros.info(now, RIG, side)
                info.width, info.height = WIDTH, HEIGHT
                info_type = "sensor_msgs/msg/CameraInfo"
                said.append(Said(now, f"/{side}/camera_info", info_type, info))
    return said


def peak_bytes(path: Path) -> int:
    """Of opening a recording and looking at every picture of it."""
    tracemalloc.start()
    try:
        drive = open_drive(path)
        for row in range(len(drive.frame_stamps_s)):
            drive.read_frame(row)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("kind", ["mcap plain", "mcap zstd", "sqlite3"])
def test_memory_does_not_grow_with_the_pictures(kind: str, tmp_path: Path) -> None:
    peaks: list[int] = []
    for count in (10, 160):
        place, said, ros = tmp_path / f"{len(peaks)}_{count}.mcap", pictures(count), Ros()
        if kind == "sqlite3":
            write_rosbag2(place, said, ros, "SQLITE3")
        else:
            write_mcap(place, said, ros, "NONE" if "plain" in kind else "ZSTD", chunk_size=200_000)
        if not peaks:
            open_drive(place)  # loads the modules
        peaks.append(peak_bytes(place))
    added = 2 * 150 * HEIGHT * WIDTH
    assert peaks[1] - peaks[0] < 0.02 * added
