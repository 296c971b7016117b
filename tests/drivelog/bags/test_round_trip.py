"""What `polemap convert` writes as MCAP is the same drive when it is read again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.writers.ros.drive import write_drive_mcap
from polemap.vehicle.io import load_car
from tests.drivelog.bags.test_reading import assert_same
from tests.drivelog.drives import write_small


@pytest.mark.parametrize("frame", [EarthFrame("utm", 32632), EarthFrame("local", name="yard")])
def test_a_converted_drive_comes_back_with_all_that_it_was(
    frame: EarthFrame, tmp_path: Path
) -> None:
    folder = replace(
        open_drive(write_small(tmp_path / "drive", frame=frame)), car=load_car("passat")
    )
    write_drive_mcap(folder, tmp_path / "drive.mcap")
    drive = open_drive(tmp_path / "drive.mcap")
    assert_same(drive, folder)
    assert (drive.name, drive.wheelbase_m) == (folder.name, load_car("passat").wheelbase_m)
    assert drive.car == folder.car
    assert drive.laps == folder.laps
    assert drive.notes[0] == "made for a test"
    assert not drive.problems
    assert len(drive.scans) == len(folder.scans)
    for ours, theirs in zip(drive.scans, folder.scans, strict=True):
        assert (ours.stamp_s, ours.arrival_s) == (theirs.stamp_s, theirs.arrival_s)
        for name in ("points_vehicle_m", "covariance_m2", "width_m", "probability"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
        assert ours.view is not None
        assert theirs.view is not None
        assert ours.view.bearing_max_rad == theirs.view.bearing_max_rad
