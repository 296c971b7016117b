"""Detecting poles in parts of a drive, kept on the disk, is detecting them in one go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.detections import Detections, VisibleRegion, pole_detections
from polemap.drivelog.readers.registry import open_drive
from polemap.perception import scan_drive
from polemap.settings import Settings
from polemap.tools.detection_cache import (
    RawScans,
    drive_fingerprint,
    raw_scans,
    read_scans,
    write_scans,
)
from polemap.tools.drive_detection import tracked


def same(one: Detections, two: Detections) -> None:
    assert (one.stamp_s, one.arrival_s) == (two.stamp_s, two.arrival_s)
    for name in (
        "points_vehicle_m",
        "covariance_m2",
        "width_m",
        "track_id",
        "probability",
        "height_m",
    ):
        assert np.array_equal(getattr(one, name), getattr(two, name), equal_nan=True), name
    assert one.view is not None
    assert two.view is not None
    assert np.array_equal(one.view.free_range_m, two.view.free_range_m)


@pytest.mark.slow
def test_poles_of_kept_parts_are_those_of_the_images(
    recording: Callable[[str], Path], tmp_path: Path
) -> None:
    """Real street: parts of a few frames, kept, read back and tracked, against the whole way."""
    whole = open_drive(recording("kitti_odometry") / "sequences" / "03")
    start_s = float(whole.frame_stamps_s[40])
    drive = whole.between(start_s, start_s + 1.0)
    settings = Settings()
    count = len(drive.frame_stamps_s)
    assert count >= 9
    parts, spent_s = [], []
    for number, rows in enumerate((range(4), range(4, count))):
        raw = raw_scans(drive, settings.polemap, settings.stereo, rows)
        assert np.all(raw.spent_s > 0.0)
        write_scans(tmp_path / f"{number}.npz", raw)
        kept = read_scans(tmp_path / f"{number}.npz")
        assert kept is not None
        parts += kept.scans
        spent_s.append(kept.spent_s)
    detected = tracked(drive, parts, settings.polemap)
    wanted = scan_drive(drive, settings.polemap, stereo=settings.stereo)
    assert sum(len(scan) for scan in wanted) > 5
    assert len(detected.scans) == len(wanted) == count
    for one, two in zip(detected.scans, wanted, strict=True):
        same(one, two)
    assert list(detected.spent_s["tracking"]) == [scan.stamp_s for scan in wanted]
    # a lower frame rate is tracked anew: as a drive that has only these frames
    rows = np.arange(0, count, 2)
    assert drive.images is not None
    half = replace(
        drive,
        frame_stamps_s=drive.frame_stamps_s[rows],
        frame_arrivals_s=drive.frame_arrivals_s[rows],
        frame_numbers=drive.frame_numbers[rows],
        images=drive.images.keep(rows),
    )
    thinned = tracked(drive, parts, settings.polemap, every=2).scans
    wanted = scan_drive(half, settings.polemap, stereo=settings.stereo)
    for one, two in zip(thinned, wanted, strict=True):
        same(one, two)
    assert drive_fingerprint(drive) == drive_fingerprint(whole.between(start_s, start_s + 1.0))
    assert drive_fingerprint(drive) != drive_fingerprint(whole.between(start_s, start_s + 0.9))


def test_scans_survive_the_cache(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    scans = []
    for number, count in enumerate((3, 0, 2)):
        view = None
        if number != 2:
            free = rng.uniform(5, 25, 4 + number)
            view = VisibleRegion(np.array([1.9, 0.1]), -0.6, 0.5, 3.0, free)
        scans.append(
            pole_detections(
                0.1 * number, 0.1 * number + 0.05, rng.normal(size=(count, 2)),
                rng.normal(size=(count, 2, 2)), width_m=rng.random(count),
                probability=rng.random(count), view=view, height_m=rng.random(count),
            ).with_columns(kind=np.full(count, number, dtype=np.int8))
        )  # fmt: skip
    path = tmp_path / "scans.npz"
    spent_s = rng.random((3, 2))
    write_scans(path, RawScans(tuple(scans), spent_s))
    back = read_scans(path)
    assert back is not None
    assert len(back.scans) == 3
    assert np.array_equal(back.spent_s, spent_s)
    for one, two in zip(scans, back.scans, strict=True):
        assert (one.stamp_s, one.arrival_s) == (two.stamp_s, two.arrival_s)
        for name, values in one.arrays().items():
            assert np.array_equal(values, getattr(two, name), equal_nan=True)
            assert values.dtype == getattr(two, name).dtype
        assert (one.view is None) == (two.view is None)
        if one.view is not None and two.view is not None:
            assert np.array_equal(one.view.free_range_m, two.view.free_range_m)
            assert one.view.bearing_min_rad == two.view.bearing_min_rad


@pytest.mark.parametrize("content", [None, b"", b"PK\x03\x04 not a zip"])
def test_a_damaged_cache_is_found_anew(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "scans.npz"
    if content is not None:
        path.write_bytes(content)
    assert read_scans(path) is None
