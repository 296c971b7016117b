"""What the commands of the docs speak of, made small: drives, recordings, logs, maps."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache, reduce
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

from polemap.drivelog.drive import Drive, Lap
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.writers.folder import write_drive
from polemap.drivelog.writers.ros.drive import write_drive_mcap
from polemap.map.io import read_map, write_map
from polemap.simulate.camera_mounting import CameraConfig
from polemap.simulate.config import RenderConfig, SimulateConfig
from polemap.simulate.drive import simulate_drive
from polemap.simulate.points.drive import PointDrive, sensed
from polemap.simulate.scenario import Scenario
from polemap.tools import cli
from tests.drivelog.bags.recordings import Ros, ros_messages, write_rosbag2
from tests.localize.point_drives import street, street_drive

# a lamp every few metres along a bend, seven seconds of it
STREET = {
    "name": "street",
    "route": {
        "closed": False,
        "corner_radius_m": 12.0,
        "corners_m": [[0, 0], [30, 0], [46, 6]],
    },
    "rows": [
        {"kind": "lamp", "side": "right", "spacing_m": 9, "offset_m": 0.5},
        {"kind": "lamp", "side": "left", "spacing_m": 12, "offset_m": 1.0},
    ],
    "drive": {"speed_mps": 7.0, "standstill_s": 0.5},
}
CAMERA = CameraConfig(width_px=320, height_px=200, focal_px=342.0, frame_rate_hz=3.0)
SETTINGS = SimulateConfig(camera=CAMERA, render=RenderConfig(workers=1, shadows=False))


class Garage:
    """Drives that stand for the user's, made once and laid where a page expects them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._made: dict[str, Path] = {}

    def lay(self, source: str, place: Path) -> None:
        """Put `source` (the name of one of the makers below) at `place`."""
        made = self.made(source)
        place.parent.mkdir(parents=True, exist_ok=True)
        if made.is_dir():
            shutil.copytree(made, place, dirs_exist_ok=True)
        else:
            shutil.copy(made, place)

    def made(self, source: str) -> Path:
        """Where `source` was made, or a part of it."""
        name, _, part = source.partition("/")
        if name not in self._made:
            self._made[name] = self.folder / name
            MAKERS[name](self, self._made[name])
        return self._made[name] / part if part else self._made[name]


def _pictured(seed: int) -> Callable[[Garage, Path], None]:
    def make(_: Garage, place: Path) -> None:
        street = Scenario.model_validate(STREET)
        simulate_drive(street, place, 1, seed, SETTINGS, objects=True)

    return make


@cache
def _city() -> PointDrive:
    return street_drive(1, 32.0)


def _street(seed: int, *, seconds: float = 12.0) -> Drive:
    """The one way through a city of poles, with the sensors' noise of `seed`."""
    made = _city()
    drive = sensed(street(), made.motion.until(seconds), made.poles, np.random.default_rng(seed))
    halves = (Lap("map", 0.0, seconds / 2), Lap("test", seconds / 2, seconds))
    return replace(drive, laps=halves)


def _scanned(seed: int, *, seconds: float = 12.0) -> Callable[[Garage, Path], None]:
    return lambda _, place: write_drive(_street(seed, seconds=seconds), place)


def _unposed(seed: int) -> Callable[[Garage, Path], None]:
    return lambda _, place: write_drive(replace(_street(seed), reference=None), place)


def _map(_: Garage, place: Path) -> None:
    write_map(_city().pole_map, place)


def _bag(source: str) -> Callable[[Garage, Path], None]:
    def make(garage: Garage, place: Path) -> None:
        ros = Ros()
        write_rosbag2(place, ros_messages(open_drive(garage.made(source)), ros), ros)

    return make


def _mcap(source: str) -> Callable[[Garage, Path], None]:
    return lambda garage, place: write_drive_mcap(open_drive(garage.made(source)), place)


def _kitti(garage: Garage, place: Path) -> None:
    words = ["convert", str(garage.made("monday")), "--to", "kitti", "--out", str(place)]
    assert cli.run(words) == cli.GOOD
    (place / "sequences" / "00").rename(place / "sequences" / "03")
    (place / "poses" / "00.txt").rename(place / "poses" / "03.txt")
    # labels beside it: a pole map in the frame of the sequence
    seen = place / "seen.gpkg"
    words = ["map", str(place / "sequences" / "03"), "--out", str(seen), "--force"]
    assert cli.run(words) == cli.GOOD
    labels = place / "poles" / "03.csv"
    labels.parent.mkdir()
    points = read_map(seen).points_m
    pd.DataFrame(points, columns=["east_m", "north_m"]).to_csv(labels, index=False)


def _can(garage: Garage, place: Path) -> None:
    """A logger's CSV with the names and units that say what they are."""
    drive = _street(1)
    assert drive.odometry is not None
    table = {
        "t [s]": 1.7e9 + drive.odometry.stamp_s,
        "speed [km/h]": 3.6 * drive.odometry.speed_mps,
        "yaw_rate [deg/s]": np.degrees(drive.odometry.yaw_rate_radps),
        "ay [m/s2]": drive.odometry.speed_mps * drive.odometry.yaw_rate_radps,
    }
    pd.DataFrame(table).to_csv(place, index=False)


def _places() -> list[tuple[datetime, float, float]]:
    """UTC, latitude and longitude of the fixes of the logger's drive, ten a second."""
    drive = _street(1)
    assert drive.reference is not None
    poses = drive.reference.poses[:, :2] - drive.reference.poses[0, :2]
    return [
        (datetime.fromtimestamp(1.7e9 + t, UTC), 48.0 + y / 111_200.0, 9.0 + x / 74_600.0)
        for t, (x, y) in zip(drive.reference.stamp_s, poses, strict=True)
    ][::2]


def _nmea(_: Garage, place: Path) -> None:
    lines = []
    for at, lat, lon in _places():
        angles = f"{lat // 1:02.0f}{lat % 1 * 60:010.7f},N,{lon // 1:03.0f}{lon % 1 * 60:010.7f},E"
        clock = at.strftime("%H%M%S.") + f"{at.microsecond // 1000:03d}"
        lines += [
            f"${body}*{reduce(lambda a, b: a ^ b, body.encode()):02X}"
            for body in (
                f"GPGGA,{clock},{angles},1,09,0.9,300.0,M,47.0,M,,",
                f"GPRMC,{clock},A,{angles},10.0,0.0,{at:%d%m%y},,,A",
            )
        ]
    place.write_text("\n".join(lines) + "\n")


def _gpx(_: Garage, place: Path) -> None:
    points = "".join(
        f'<trkpt lat="{lat:.8f}" lon="{lon:.8f}"><time>{at.isoformat()}</time></trkpt>'
        for at, lat, lon in _places()
    )
    place.write_text(
        '<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>'
        f"{points}</trkseg></trk></gpx>"
    )


def _signals(_: Garage, place: Path) -> None:
    place.write_text(
        "signals:\n  stamp_s: {column: 't [s]', unit: s}\n"
        "  vx_mps: {column: 'speed [km/h]', unit: km/h}\n"
        "  yaw_rate_radps: {column: 'yaw_rate [deg/s]', unit: deg/s, turn: counter_clockwise}\n"
        "  ay_mps2: {column: 'ay [m/s2]', unit: m/s2}\n"
    )


def _estimator_log(_: Garage, place: Path) -> None:
    """Ten seconds of a car that weaves."""
    stamps = np.arange(0.0, 10.0, 0.01)
    angle = 0.03 * np.sin(stamps)
    table = {
        "stamp_s": stamps,
        "road_wheel_angle_rad": angle,
        "yaw_rate_radps": 20.0 * angle / 2.4,
        "ay_mps2": 20.0**2 * angle / 2.4,
        "vx_mps": np.full(len(stamps), 20.0),
    }
    pd.DataFrame(table).to_csv(place, index=False)


def _driven_log(garage: Garage, place: Path) -> None:
    """A drive with pictures and its car's signals beside them."""
    shutil.copytree(garage.made("monday"), place)
    odometry = open_drive(place).odometry
    assert odometry is not None
    table = {
        "stamp_s": odometry.stamp_s,
        "road_wheel_angle_rad": 2.7 * odometry.yaw_rate_radps / np.maximum(odometry.speed_mps, 1.0),
        "yaw_rate_radps": odometry.yaw_rate_radps,
        "vx_mps": odometry.speed_mps,
    }
    pd.DataFrame(table).to_csv(place / "signals.csv", index=False)


def _my_street(_: Garage, place: Path) -> None:
    place.write_text(yaml.safe_dump(STREET))


def _block(_: Garage, place: Path) -> None:
    """A world that stands for any other: once round a block with a few lamps."""
    corners = [[0, 0], [20, 0], [20, 20], [0, 20]]
    route = {"closed": True, "corner_radius_m": 6.0, "corners_m": corners}
    place.write_text(yaml.safe_dump({**STREET, "route": route, "backdrop": False}))


def _revs(_: Garage, place: Path) -> None:
    place.mkdir()
    shutil.copy(REVS, place)


REVS = Path(__file__).resolve().parents[2] / "shared" / "data" / "revs_250lm" / "signals.csv.gz"


MAKERS: dict[str, Callable[[Garage, Path], object]] = {
    "monday": _pictured(1),
    "friday": _pictured(2),
    "lap_1": _scanned(1),
    "lap_2": _scanned(2),
    "long_1": _scanned(1, seconds=32.0),
    "long_2": _scanned(2, seconds=32.0),
    "taxi": _unposed(1),
    "taxi_friday": _unposed(2),
    "bag_monday": _bag("monday"),
    "bag_friday": _bag("friday"),
    "drive_mcap": _mcap("monday"),
    "street_mcap": _mcap("lap_1"),
    "kitti": _kitti,
    "can": _can,
    "nmea": _nmea,
    "gpx": _gpx,
    "signals": _signals,
    "map.gpkg": _map,
    "estimator_log": _estimator_log,
    "driven_log": _driven_log,
    "revs": _revs,
    "my_street": _my_street,
    "block": _block,
}
