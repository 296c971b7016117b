"""A run as an MCAP file for Foxglove: poses, paths, poles, pictures, health, and a layout."""

from __future__ import annotations

import heapq
import json
from collections.abc import Callable, Iterator
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.frames import geographic_from_grid
from polemap.drivelog.writers.ros import messages as ros
from polemap.drivelog.writers.ros.mcap_file import mcap_file
from polemap.drivelog.writers.ros.types import message_types
from polemap.tools.recording.foxglove_shapes import (
    car_message,
    picture_annotations,
    poles_message,
    seen_poles_message,
)
from polemap.tools.recording.layout import layout
from polemap.tools.recording.scene import Scene
from polemap.vehicle.pose import pose_rotation

Floats = NDArray[np.float64]
# time, topic, message
Event = tuple[float, str, Any]

POSE, PF, HEALTH, DIAGNOSTICS = "/localization/pose", "/localization/pf", "/health", "/diagnostics"
MAP_POLES, SEEN_POLES, CAR = "/map/poles", "/seen/poles", "/car"
IMAGE, INFO, NOTES_ON_IMAGE = (
    "/camera/left/compressed", "/camera/left/camera_info", "/camera/left/annotations",
)  # fmt: skip
FIX = "/localization/fix"

_OK, _WARN = 0, 1


def write_foxglove(
    scene: Scene, path: Path, advance: Callable[[int], None] | None = None
) -> tuple[dict[str, int], Path]:
    """Write a run as MCAP, and the layout that shows it as `NAME.layout.json` beside it.

    Args:
        advance: called with 1 after every picture.

    Returns:
        Messages by topic, and the layout's path.

    Raises:
        InputError: stamps before zero, or an image that cannot be read.
        MissingExtraError: mcap or rosbags is not installed.
    """
    beside = layout_path(path)
    with atomic_file(path) as part, mcap_file(part) as file:
        for stamp_s, topic, message in heapq.merge(
            *_streams(scene, advance), key=lambda event: event[0]
        ):
            file.write(topic, message, stamp_s)
        east, north = scene.origin_m
        file.describe(
            "polemap",
            {
                "run": scene.name,
                "frame": str(scene.frame),
                "origin_east_m": f"{east:.0f}",
                "origin_north_m": f"{north:.0f}",
            },
        )
    with atomic_file(beside) as part:
        shown = layout(
            with_pictures=scene.pictures is not None,
            on_earth=scene.is_geographic,
            with_poles=len(scene.pf) > 0,
        )
        part.write_text(json.dumps(shown, indent=1) + "\n", encoding="utf-8")
    return file.counts, beside


def layout_path(path: Path) -> Path:
    """Where the layout of a recording goes."""
    return path.with_name(f"{path.stem}.layout.json")


def _streams(scene: Scene, advance: Callable[[int], None] | None) -> list[Iterator[Event]]:
    streams = [_start(scene), _output(scene), _updates(scene), _seen(scene)]
    if scene.pictures is not None:
        streams.append(_images(scene, advance))
    return streams


def _start(scene: Scene) -> Iterator[Event]:
    """What stands still: paths, poles and the shape of the car."""
    begin = float(scene.kf.stamp_s[0])
    if len(scene.pf):
        begin = min(begin, float(scene.pf.stamp_s[0]))
    if scene.rig is not None:
        yield begin, "/tf_static", ros.transforms(ros.camera_transforms(scene.rig, begin))
    for name, path in scene.paths.items():
        yield begin, f"/path/{name}", ros.path(begin, ros.MAP, path.stamp_s, path.poses)
    if scene.poles is not None:
        yield begin, MAP_POLES, poles_message(scene.poles, scene.frame, begin)
    yield begin, CAR, car_message(begin)


def _output(scene: Scene) -> Iterator[Event]:
    """The 100 Hz output: pose, transform, and where the frame is tied to the earth a fix."""
    kf, beside = scene.kf, scene.kf_beside
    speed, turn = (
        _numbers(beside, "speed_mps", len(kf)),
        _numbers(beside, "yaw_rate_radps", len(kf)),
    )
    names = ("var_east_m2", "var_north_m2", "cov_east_north_m2", "var_yaw_rad2")
    variance = np.stack([_numbers(beside, name, len(kf)) for name in names], axis=1)
    places = None
    if scene.is_geographic:
        places = geographic_from_grid(scene.frame, kf.poses[:, :2] + scene.origin_m)
    for row, stamp in enumerate(kf.stamp_s.tolist()):
        covariance, pose = _covariance(variance[row]), kf.poses[row]
        yield stamp, POSE, ros.odometry(
            stamp, ros.MAP, pose, covariance, _or_zero(speed[row]), _or_zero(turn[row])
        )  # fmt: skip
        turned = pose_rotation(float(pose[2]))
        car = ros.transform(stamp, ros.MAP, ros.VEHICLE, (*pose[:2], 0.0), turned)
        yield stamp, "/tf", ros.transforms([car])
        if places is not None and row % 10 == 0:
            sd_m = float(np.sqrt(max(variance[row, 0], variance[row, 1])))
            yield stamp, FIX, ros.nav_sat_fix(stamp, places[row, 0], places[row, 1], sd_m)


def _updates(scene: Scene) -> Iterator[Event]:
    """Poses of the particle filter with their health, as numbers to plot and as a diagnostic."""
    count = len(scene.pf)
    numbers = {
        name: _numbers(scene.pf_beside, name, count)
        for name in ("matched", "seen", "in_view", "n_eff", "position_sd_major_m", "healthy")
    }
    gate = scene.pf_beside.get("gate", [""] * count)
    make = message_types().make
    for row, stamp in enumerate(scene.pf.stamp_s.tolist()):
        yield stamp, PF, ros.stamped_pose_with_covariance(
            stamp, ros.MAP, scene.pf.poses[row], None
        )  # fmt: skip
        values = {name: float(column[row]) for name, column in numbers.items()}
        yield stamp, HEALTH, make(
            "polemap_msgs/msg/Health", header=ros.header(stamp, ros.VEHICLE), **values
        )  # fmt: skip
        yield stamp, DIAGNOSTICS, _diagnostic(stamp, values, str(gate[row]))


def _diagnostic(stamp_s: float, values: dict[str, float], gate: str) -> Any:
    make = message_types().make
    known, good = isfinite(values["healthy"]), values["healthy"] > 0
    level = _OK if good or not known else _WARN
    said = "healthy" if good else ("health is not known" if not known else "not to be trusted")
    shown = {name: f"{value:g}" for name, value in values.items()} | {"gate": gate}
    return make(
        "diagnostic_msgs/msg/DiagnosticArray",
        header=ros.header(stamp_s, ros.VEHICLE),
        status=[
            make(
                "diagnostic_msgs/msg/DiagnosticStatus",
                level=level, name="polemap: localization", message=said, hardware_id="polemap",
                values=[make("diagnostic_msgs/msg/KeyValue", key=k, value=v)
                        for k, v in shown.items()],
            )
        ],
    )  # fmt: skip


def _seen(scene: Scene) -> Iterator[Event]:
    for scan in scene.scans:
        yield scan.stamp_s, SEEN_POLES, seen_poles_message(scan)


def _images(scene: Scene, advance: Callable[[int], None] | None) -> Iterator[Event]:
    rig = scene.rig
    if scene.pictures is None or rig is None:
        return
    for picture in scene.pictures():
        stamp = picture.stamp_s
        yield stamp, INFO, ros.camera_info(rig, stamp, right=False)
        yield stamp, IMAGE, ros.compressed_image(stamp, ros.LEFT_CAMERA, "jpeg", picture.jpeg)
        yield stamp, NOTES_ON_IMAGE, picture_annotations(picture)
        if advance is not None:
            advance(1)


def _covariance(row: Floats) -> Floats | None:
    if not np.isfinite(row).all():
        return None
    east, north, cross, yaw = row
    return np.array([[east, cross, 0.0], [cross, north, 0.0], [0.0, 0.0, yaw]])


def _numbers(columns: Any, name: str, count: int) -> Floats:
    """A column of numbers; NaN where it is not known."""
    column = columns.get(name)
    return column if isinstance(column, np.ndarray) else np.full(count, np.nan)


def _or_zero(value: float) -> float:
    return float(value) if isfinite(value) else 0.0
