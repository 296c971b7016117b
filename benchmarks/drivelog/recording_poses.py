"""Map and poses of a drive read from recordings of every kind against those from its folder.

KITTI odometry 03 and a simulated street, written by rosbags and mcap; the figures are the largest
differences of poles (metres) and of poses (metres and radians).
"""

from __future__ import annotations

import tempfile
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from rosbags.typesys import Stores

from benchmarks.harness import RECORDINGS, Figures
from polemap.drivelog.drive import Drive
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.tum import read_tum
from polemap.drivelog.writers.folder import write_drive
from polemap.map.io import read_map
from polemap.simulate.config import SimulateConfig
from polemap.simulate.drive import simulate_drive
from polemap.simulate.scenario import Scenario
from polemap.stereo.rig import Mounting
from polemap.tools.cli import run as polemap
from tests.drivelog.bags import recordings

Floats = NDArray[np.float64]

STREET = Scenario.model_validate(
    {
        "name": "street",
        "route": {"closed": False, "corner_radius_m": 8.0, "corners_m": [[0, 0], [50, 0]]},
        "rows": [
            {"kind": "lamp", "side": "right", "spacing_m": 9, "offset_m": 0.5},
            {"kind": "lamp", "side": "left", "spacing_m": 12, "offset_m": 1.0},
        ],
        "drive": {"speed_mps": 7.0, "standstill_s": 0.5},
    }
)


def recordable(drive: Drive) -> Drive:
    """The drive with stamps of whole nanoseconds and a mounting of 1e-12, as recordings hold it."""

    def rounded(stream: Any, *names: str) -> Any:
        columns = {name: np.round(getattr(stream, name), 9) for name in names}
        return None if stream is None else replace(stream, **columns)

    assert drive.rig is not None
    mount = Mounting(*(round(value, 12) for value in astuple(drive.rig.vehicle_from_camera)))
    return replace(
        drive,
        rig=replace(drive.rig, vehicle_from_camera=mount),
        odometry=rounded(drive.odometry, "stamp_s", "arrival_s"),
        gnss=rounded(drive.gnss, "stamp_s", "arrival_s"),
        reference=rounded(drive.reference, "stamp_s"),
    )


def write_all(drive: Drive, place: Path) -> dict[str, Path]:
    """The drive in every container."""
    ros, one = recordings.Ros(), recordings.Ros(Stores.ROS1_NOETIC)
    said, said_one = (recordings.ros_messages(drive, made, png=True) for made in (ros, one))
    return {
        "rosbag1": recordings.write_rosbag1(place / "a.bag", said_one, one),
        "rosbag2_sqlite3": recordings.write_rosbag2(place / "b", said, ros, "SQLITE3"),
        "rosbag2_mcap": recordings.write_rosbag2(place / "c", said, ros, "MCAP", "STORAGE"),
        "mcap": recordings.write_mcap(place / "d.mcap", said, ros),
    }


def results(drive: Path, place: Path, *options: str) -> list[Floats]:
    """Poles of its map, and the poses of both filters in it."""
    seen, out = place / f"{drive.stem}.gpkg", place / f"run_{drive.stem}"
    commands = (
        ["map", str(drive), "--out", str(seen)],
        ["localize", str(drive), "--map", str(seen), "--out", str(out)],
    )
    for command in commands:
        if polemap([*command, "--force", *options]) != 0:
            raise RuntimeError(f"polemap {' '.join(command)} failed")
    return [
        read_map(seen).points_m,
        *(read_tum(out / f"{kind}.tum").poses for kind in ("pf", "kf")),
    ]


def compare(drive: Drive, place: Path) -> dict[str, float]:
    """By container the largest difference over poles and poses; 0 is bit for bit."""
    folder = place / "folder"
    write_drive(recordable(drive), folder)
    told = place / "topics.yaml"
    local = {"gnss": {"topic": "/gnss/local"}} if not drive.frame.is_utm else {}
    parts = {"vehicle": {"wheelbase_m": drive.wheelbase_m}, "frame": drive.frame.to_dict()}
    told.write_text(yaml.safe_dump({**parts, **local}))
    wanted = results(folder, place)
    found = {}
    for name, path in write_all(open_drive(folder), place).items():
        ours = results(path, place, "--topics", str(told))
        found[name] = max(
            float(np.abs(mine - theirs).max()) for mine, theirs in zip(ours, wanted, strict=True)
        )
    return found


def run() -> Figures:
    """Largest differences by drive and container."""
    figures: Figures = {}
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        street = simulate_drive(STREET, place / "street", 1, 3, SimulateConfig())
        drives = {"simulated": open_drive(street)}
        kitti = RECORDINGS / "kitti_odometry" / "sequences" / "03"
        if kitti.is_dir():
            drives["kitti_03"] = open_drive(kitti)
        for name, drive in drives.items():
            own = place / name
            own.mkdir()
            found = compare(drive, own)
            figures[f"recording_poses_{name}"] = {f"{kind}_m": d for kind, d in found.items()}
    return figures
