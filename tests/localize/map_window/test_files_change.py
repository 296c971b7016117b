"""What becomes of a drive when its map's file is deleted, replaced or written over on the way."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from polemap.simulate.points.drive import PointDrive
from tests.city_maps import opened
from tests.localize.map_window.driving import live, play, until

HALF_S = 3.0


def deleted(path: Path) -> None:
    path.unlink()


def replaced(path: Path) -> None:
    other = path.with_name("new")
    other.write_bytes(b"another map")
    other.replace(path)


def cut(path: Path) -> None:
    with path.open("r+b") as stream:
        stream.truncate(path.stat().st_size // 3)


@pytest.mark.usefixtures("small_windows")
@pytest.mark.parametrize("change", [deleted, replaced, cut])
@pytest.mark.parametrize("ending", ["gpkg", "parquet"])
def test_the_drive_goes_on(
    drive: PointDrive,
    files: dict[str, Path],
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    ending: str,
    change: Callable[[Path], None],
) -> None:
    path = Path(shutil.copy(files[ending], tmp_path))
    city = opened(path).uncached()  # so that every window is read from the file
    localizer = live(drive, city)
    samples = until(drive, 8.0)
    half = [sample for sample in samples if sample.arrival_s < HALF_S]
    with caplog.at_level(logging.WARNING, logger="polemap"):
        play(localizer, half, settle=True)
        change(path)
        answers = play(localizer, samples[len(half) :], settle=True)
    stamps = np.array([answer.stamp_s for answer in answers])
    off = np.hypot(*(np.array([a.pose[:2] for a in answers]) - drive.motion.at(stamps)[:, :2]).T)
    summary = localizer.summary()
    said = [record.getMessage() for record in caplog.records]
    if change is cut:
        # the poles that are there serve on; what lies beyond is said and counted
        assert summary["pf_map_tiles_damaged"] == len(said) > 0
        assert all(text.startswith(str(path)) and "\n" not in text for text in said)
        assert off.max() < 5.0
    else:
        assert said == []
        assert summary["pf_map_windows"] > 1
        assert off.max() < 1.5
