"""A run as an MCAP file for Foxglove: poses, paths, poles, pictures, health, and a layout."""

from __future__ import annotations

import heapq
import json
from collections.abc import Callable, Iterator, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.detections import Detections
from polemap.drivelog.frames import EarthFrame, geographic_from_grid
from polemap.drivelog.writers.ros import messages as ros
from polemap.drivelog.writers.ros.mcap_file import mcap_file
from polemap.drivelog.writers.ros.types import message_types, named_values
from polemap.tools.recording.layout import layout
from polemap.tools.recording.scene import HEIGHT_M, WIDTH_M, Picture, Poles, Scene
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

_MAPPED, _SEEN, _CAR = (1.0, 0.6, 0.2), (0.3, 0.85, 0.25), (0.2, 0.5, 0.9)
_OK, _WARN = 0, 1
_CAR_SIZE_M = (4.5, 1.8, 1.5)
_AXLE_TO_MIDDLE_M = 1.35
# how long a pole that was seen stays drawn
_SEEN_S = 0.5
_LINE_LIST = 4


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
        yield scan.stamp_s, SEEN_POLES, _seen_poles(scan)


def _images(scene: Scene, advance: Callable[[int], None] | None) -> Iterator[Event]:
    rig = scene.rig
    if scene.pictures is None or rig is None:
        return
    for picture in scene.pictures():
        stamp = picture.stamp_s
        yield stamp, INFO, ros.camera_info(rig, stamp, right=False)
        yield stamp, IMAGE, ros.compressed_image(stamp, ros.LEFT_CAMERA, "jpeg", picture.jpeg)
        yield stamp, NOTES_ON_IMAGE, _annotations(picture)
        if advance is not None:
            advance(1)


def _annotations(picture: Picture) -> Any:
    make = message_types().make
    lines = [
        make(
            "foxglove_msgs/msg/PointsAnnotation",
            timestamp=ros.time_of(picture.stamp_s), type=_LINE_LIST,
            points=[
                make("foxglove_msgs/msg/Point2", x=float(x), y=float(y))
                for x, y in ends.reshape(-1, 2)
            ],
            outline_color=_colour(colour), outline_colors=[], fill_color=_colour(colour, 0.0),
            thickness=thickness,
        )
        for ends, colour, thickness in (
            (picture.mapped_px, _MAPPED, 3.0), (picture.seen_px, _SEEN, 2.0),
        )
    ]  # fmt: skip
    return make("foxglove_msgs/msg/ImageAnnotations", circles=[], points=lines, texts=[])


def poles_message(poles: Poles, frame: EarthFrame, stamp_s: float) -> Any:
    """The map's poles as a SceneUpdate.

    One entity for all: viewers slow down with thousands of entities, not of primitives.
    """
    cylinders = [
        _cylinder(point, width, height, _MAPPED, 0.3 + 0.7 * existence)
        for point, width, height, existence in zip(
            poles.points_m, poles.width_m, poles.height_m, poles.existence, strict=True
        )
    ]
    about = {"poles": str(len(cylinders)), "frame": str(frame)}
    return _scene_update(stamp_s, ros.MAP, "map", cylinders=cylinders, metadata=about)


def _seen_poles(scan: Detections) -> Any:
    width = np.where(np.isfinite(scan.width_m), scan.width_m, WIDTH_M)
    height = np.where(np.isfinite(scan.height_m), scan.height_m, HEIGHT_M)
    cylinders = [
        _cylinder(point, 1.5 * wide, high, _SEEN, 0.8)
        for point, wide, high in zip(scan.points_vehicle_m, width, height, strict=True)
    ]
    return _scene_update(
        scan.stamp_s, ros.VEHICLE, "seen", cylinders=cylinders, lifetime_s=_SEEN_S
    )  # fmt: skip


def car_message(stamp_s: float) -> Any:
    """The shape of the car as a SceneUpdate that moves with it."""
    cube = message_types().make(
        "foxglove_msgs/msg/CubePrimitive",
        pose=ros.pose(_AXLE_TO_MIDDLE_M, 0.0, 0.0, 0.5 * _CAR_SIZE_M[2]),
        size=ros.vector(*_CAR_SIZE_M), color=_colour(_CAR, 0.7),
    )  # fmt: skip
    return _scene_update(stamp_s, ros.VEHICLE, "car", cubes=[cube], locked=True)


def _cylinder(
    point_m: Floats, width_m: float, height_m: float, colour: Sequence[float], opacity: float
) -> Any:
    return message_types().make(
        "foxglove_msgs/msg/CylinderPrimitive",
        pose=ros.pose(float(point_m[0]), float(point_m[1]), 0.0, 0.5 * float(height_m)),
        size=ros.vector(width_m, width_m, height_m),
        bottom_scale=1.0, top_scale=1.0, color=_colour(colour, float(opacity)),
    )  # fmt: skip


def _scene_update(
    stamp_s: float,
    frame: str,
    name: str,
    *,
    cylinders: Sequence[Any] = (),
    cubes: Sequence[Any] = (),
    metadata: dict[str, str] | None = None,
    lifetime_s: float = 0.0,
    locked: bool = False,
) -> Any:
    make = message_types().make
    seconds, rest = divmod(round(lifetime_s * 1e9), 1_000_000_000)
    entity = make(
        "foxglove_msgs/msg/SceneEntity",
        timestamp=ros.time_of(stamp_s), frame_id=frame, id=name,
        lifetime=make("builtin_interfaces/msg/Duration", sec=seconds, nanosec=rest),
        frame_locked=locked, metadata=named_values(metadata or {}),
        arrows=[], cubes=list(cubes), spheres=[], cylinders=list(cylinders), lines=[],
        triangles=[], texts=[], models=[],
    )  # fmt: skip
    return make("foxglove_msgs/msg/SceneUpdate", deletions=[], entities=[entity])


def _colour(rgb: Sequence[float], opacity: float = 1.0) -> Any:
    r, g, b = rgb
    return message_types().make("foxglove_msgs/msg/Color", r=r, g=g, b=b, a=opacity)


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
