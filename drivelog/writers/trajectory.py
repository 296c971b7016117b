"""Trajectories as the files that other tools read, chosen by the ending.

| ending | content | earth frame |
|---|---|---|
| `.tum` | `stamp x y z qx qy qz qw`, full precision (evo, ROS tools) | any |
| `.kitti` | 3x4 poses in the axes of KITTI's camera, the first one the identity, no stamps | any |
| `.csv` | a row a pose with what else is known of it | any; latitude and longitude with utm |
| `.gpx` | a track of GPX 1.1, for navigation programs | utm |
| `.geojson` | RFC 7946: the line and a point a pose, for GIS | utm |
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.errors import ConfigError, FrameError
from polemap.drivelog.frames import EarthFrame, geographic_from_grid
from polemap.drivelog.tum import shortest, tum_text
from polemap.vehicle.pose import rotation
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]
# what is known of each pose beside it: numbers (NaN where unknown) or words
Columns = Mapping[str, Floats | Sequence[str]]

ENDINGS = (".tum", ".kitti", ".csv", ".gpx", ".geojson")
_ON_EARTH = (".gpx", ".geojson")
# x right, y down, z forward (KITTI's camera) in x forward, y left, z up
_VEHICLE_FROM_CAMERA_AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
# clocks that count from the switching-on of a computer do not reach this: 9 September 2001
EPOCH_FROM_S = 1e9
# the last second that every calendar library knows, in the year 9999
_EPOCH_TO_S = 253_402_300_799.0


def check_trajectory_file(path: Path, frame: EarthFrame) -> None:
    """Refuse, before work begins, what `write_trajectory` would refuse at its end.

    Raises:
        ConfigError: an ending that names no format.
        FrameError: the format needs latitude and longitude, and the frame is local.
    """
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise ConfigError(f"{path}: a trajectory ends in {', '.join(ENDINGS)}")
    if ending in _ON_EARTH and not frame.is_utm:
        raise FrameError(
            f"{path}: {ending} holds latitude and longitude, but this trajectory is in {frame}, "
            "which is not tied to the earth; write .tum, .kitti or .csv"
        )


def write_trajectory(
    path: Path, trajectory: Trajectory, frame: EarthFrame, name: str, beside: Columns | None = None
) -> list[str]:
    """Write planar rear-axle poses in the format of the ending.

    Args:
        name: what the track is called inside the file.
        beside: further columns of `.csv` and `.geojson`, `(n,)` each.

    Returns:
        What the reader of the file has to know.

    Raises:
        ConfigError: an ending that names no format, or a trajectory without poses.
        FrameError: the format needs latitude and longitude, and the frame is local.
    """
    check_trajectory_file(path, frame)
    if not len(trajectory):
        raise ConfigError(f"{path}: the trajectory {name} holds no pose, nothing to write")
    ending, columns = path.suffix.lower(), beside or {}
    notes = []
    if ending == ".tum":
        lines: Iterator[str] = iter([tum_text(trajectory)])
    elif ending == ".kitti":
        lines = _kitti_lines(trajectory)
        notes = ["KITTI poses carry no stamps: line n is pose n; write .tum to keep them"]
    elif ending == ".csv":
        lines = _csv_lines(trajectory, frame, columns)
    elif ending == ".gpx":
        lines = _gpx_lines(trajectory, frame, name)
        if not counts_from_1970(trajectory.stamp_s):
            notes = ["the stamps do not count from 1970, so the track carries no times"]
    else:
        lines = _geojson_lines(trajectory, frame, name, columns)
    with atomic_file(path) as part, part.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(lines)
    return notes


def kitti_poses(trajectory: Trajectory) -> Floats:
    """Poses `(n, 3, 4)` in camera axes (x right, y down, z forward) from the first one's frame."""
    turned = rotation(trajectory.poses[:, 2])
    world = np.tile(np.eye(4), (len(trajectory), 1, 1))
    world[:, :2, :2] = turned
    world[:, :2, 3] = trajectory.poses[:, :2]
    axes = np.eye(4)
    axes[:3, :3] = _VEHICLE_FROM_CAMERA_AXES
    from_first = np.linalg.inv(world[0] @ axes) @ world @ axes
    return np.asarray(from_first[:, :3])


def counts_from_1970(stamps_s: Floats) -> bool:
    """Whether stamps can be seconds since 1970 (UTC)."""
    return bool(len(stamps_s) and stamps_s[0] >= EPOCH_FROM_S and stamps_s[-1] <= _EPOCH_TO_S)


def _kitti_lines(trajectory: Trajectory) -> Iterator[str]:
    for row in kitti_poses(trajectory).reshape(-1, 12):
        yield " ".join(f"{value:.12e}" for value in row) + "\n"


def _csv_lines(trajectory: Trajectory, frame: EarthFrame, columns: Columns) -> Iterator[str]:
    names = ["stamp_s", "east_m", "north_m", "yaw_rad"]
    values: list[Sequence[object]] = [
        trajectory.stamp_s.tolist(), *trajectory.poses.T.tolist()
    ]  # fmt: skip
    if frame.is_utm:
        names += ["latitude_deg", "longitude_deg"]
        values += geographic_from_grid(frame, trajectory.poses[:, :2]).T.tolist()
    for name, column in columns.items():
        names.append(name)
        values.append([_plain(value) for value in column])
    yield ",".join(names) + "\n"
    for row in zip(*values, strict=True):
        yield ",".join("" if value is None else _cell(value) for value in row) + "\n"


def _gpx_lines(trajectory: Trajectory, frame: EarthFrame, name: str) -> Iterator[str]:
    dated = counts_from_1970(trajectory.stamp_s)
    yield '<?xml version="1.0" encoding="UTF-8"?>\n'
    yield '<gpx version="1.1" creator="polemap" xmlns="http://www.topografix.com/GPX/1/1">\n'
    yield f"<trk><name>{escape(name)}</name><trkseg>\n"
    places = geographic_from_grid(frame, trajectory.poses[:, :2])
    for stamp_s, (latitude, longitude) in zip(trajectory.stamp_s, places, strict=True):
        time = ""
        if dated:
            moment = datetime.fromtimestamp(float(stamp_s), UTC)
            time = f"<time>{moment.isoformat(timespec='milliseconds')[:-6]}Z</time>"
        yield f'<trkpt lat="{latitude:.9f}" lon="{longitude:.9f}">{time}</trkpt>\n'
    yield "</trkseg></trk>\n</gpx>\n"


def _geojson_lines(
    trajectory: Trajectory, frame: EarthFrame, name: str, columns: Columns
) -> Iterator[str]:
    """Longitude before latitude, as RFC 7946 wants; the grid coordinates are kept as well."""
    places = np.round(geographic_from_grid(frame, trajectory.poses[:, :2])[:, ::-1], 9).tolist()
    head = {"format_version": 1, "frame": frame.to_dict()}
    yield f'{{"type": "FeatureCollection", "polemap": {json.dumps(head)}, "features": [\n'
    line: dict[str, object] = {"type": "LineString", "coordinates": places}
    if len(places) == 1:  # a line has two points at least
        line = {"type": "Point", "coordinates": places[0]}
    yield _feature(line, {"name": name, "poses": len(places)})
    kept = {key: [_plain(value) for value in column] for key, column in columns.items()}
    for row, (stamp, pose, place) in enumerate(
        zip(trajectory.stamp_s.tolist(), trajectory.poses.tolist(), places, strict=True)
    ):
        values = {"stamp_s": stamp, "east_m": pose[0], "north_m": pose[1], "yaw_rad": pose[2]}
        values |= {key: column[row] for key, column in kept.items()}
        yield ",\n" + _feature({"type": "Point", "coordinates": place}, values)
    yield "\n]}\n"


def _feature(geometry: Mapping[str, object], properties: Mapping[str, object]) -> str:
    feature = {"type": "Feature", "geometry": geometry, "properties": properties}
    return json.dumps(feature, allow_nan=False, ensure_ascii=False)


def _plain(value: object) -> float | str | None:
    """A number or word; None where a number is not known."""
    if isinstance(value, str):
        return value or None
    number = float(value)  # type: ignore[arg-type]
    return number if np.isfinite(number) else None


def _cell(value: object) -> str:
    if isinstance(value, float):
        return shortest(value)
    return str(value)
