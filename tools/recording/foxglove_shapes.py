"""Shapes that Foxglove draws: poles and car in space, poles on the picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.writers.ros import messages as ros
from polemap.drivelog.writers.ros.types import message_types, named_values
from polemap.tools.recording.scene import HEIGHT_M, WIDTH_M, Picture, Poles

Floats = NDArray[np.float64]

_MAPPED, _SEEN, _CAR = (1.0, 0.6, 0.2), (0.3, 0.85, 0.25), (0.2, 0.5, 0.9)
_CAR_SIZE_M = (4.5, 1.8, 1.5)
_AXLE_TO_MIDDLE_M = 1.35
# how long a pole that was seen stays drawn
_SEEN_S = 0.5
_LINE_LIST = 4


def picture_annotations(picture: Picture) -> Any:
    """Lines on a picture along the map's poles and those that were seen."""
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


def seen_poles_message(scan: Detections) -> Any:
    """The poles of a scan as a SceneUpdate in the car's frame."""
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
