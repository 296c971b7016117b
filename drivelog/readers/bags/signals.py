"""Odometry, GNSS and reference of a recording as streams at the rear axle."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections, VisibleRegion, pole_detections
from polemap.drivelog.frames import EarthFrame, grid_from_geographic
from polemap.drivelog.readers.bags import mapping as m
from polemap.drivelog.readers.bags.clocks import LogClock, seconds, times_of
from polemap.drivelog.readers.bags.index import LogIndex, Topic
from polemap.drivelog.readers.bags.transforms import rotation_from_quaternion
from polemap.drivelog.readers.bags.vehicle_frame import VehicleFrame
from polemap.drivelog.streams import (
    SD_AT_DILUTION_ONE_M,
    GnssStream,
    ReferenceStream,
)
from polemap.vehicle.pose import rotate, wrap_angle

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# metres, metres a second and radians a second of any car stay far below
_LARGEST = 1e9
_UNKNOWN_FRAME = (
    "{topic}: '{frame}' is not tied to the car by TF: its poses are taken to be those of the rear "
    "axle"
)


@dataclass(frozen=True, slots=True)
class Signals:
    """What streams are made from."""

    index: LogIndex
    vehicle: VehicleFrame
    clock: LogClock
    problems: Counter[str]
    notes: list[str]

    def in_order(
        self,
        topic: Topic,
        name: str,
        values: Floats,
        usable: NDArray[np.bool_] | None = None,
        optional: int = 0,
    ) -> tuple[Integers, Integers, Floats]:
        """Stamps, arrivals and rows `(n, k)` sorted by stamp; what cannot be used is counted.

        Args:
            topic: of the values.
            name: of the stream, in the counts.
            values: `(n, k)`.
            usable: `(n,)` rows to keep; the caller has counted the others.
            optional: how many of the last columns may be NaN.
        """
        times = times_of(topic, self.clock, name, self.problems, self.notes)
        stamp, arrival = times.stamp_ns, times.arrival_ns
        needed = values[:, : values.shape[1] - optional]
        finite = np.isfinite(needed).all(axis=1) & (np.abs(needed) < _LARGEST).all(axis=1)
        if usable is None:
            usable = np.ones(len(values), dtype=bool)
        if lost := int(np.count_nonzero(usable & ~finite)):
            self.problems[f"{name}_not_finite"] += lost
        finite &= usable
        stamp, arrival, values = stamp[finite], arrival[finite], values[finite]
        if back := int(np.count_nonzero(np.diff(stamp) < 0)):
            self.notes.append(f"{topic.name}: {back} messages come out of order: sorted by stamp")
        order = np.argsort(stamp, kind="stable")
        stamp, arrival, values = stamp[order], arrival[order], values[order]
        first = np.concatenate([[True], np.diff(stamp) > 0]) if len(stamp) else np.zeros(0, bool)
        if twice := int(np.count_nonzero(~first)):
            self.problems[f"{name}_duplicate_stamps"] += twice
        return stamp[first], arrival[first], values[first]


def gnss_stream(signals: Signals, part: m.GnssPart, frame: EarthFrame) -> GnssStream:
    """Fixes in the drive's frame; those that state to be none are left out and counted."""
    topic = signals.index.topics[part.topic]
    if topic.kind != "gnss":
        return _local_fixes(signals, topic)
    columns = [topic.column(name) for name in ("latitude_deg", "longitude_deg")]
    usable = topic.column("status") >= 0
    if lost := int(np.count_nonzero(~usable)):
        signals.problems["gnss_without_fix"] += lost
    variance = (topic.column("var_east_m2") + topic.column("var_north_m2")) / 2.0
    known = np.isfinite(variance) & (variance > 0)
    hdop = np.ones(len(variance))
    hdop[known] = np.sqrt(variance[known]) / SD_AT_DILUTION_ONE_M
    bad = (np.abs(columns[0]) > 90) | (np.abs(columns[1]) > 180)
    if lost := int(np.count_nonzero(bad & usable)):
        signals.problems["gnss_out_of_range"] += lost
    stamp, arrival, values = signals.in_order(
        topic, "gnss", np.stack([*columns, hdop], axis=1), usable & ~bad
    )
    points = grid_from_geographic(frame, values[:, 0], values[:, 1]).reshape(-1, 2)
    return GnssStream(seconds(stamp), seconds(arrival), points[:, 0], points[:, 1], values[:, 2])


def _local_fixes(signals: Signals, topic: Topic) -> GnssStream:
    """Positions of a receiver that works in a local frame already."""
    variance = (topic.column("var_x_m2") + topic.column("var_y_m2")) / 2.0
    known = np.isfinite(variance) & (variance > 0)
    hdop = np.where(known, np.sqrt(np.where(known, variance, 1.0)) / SD_AT_DILUTION_ONE_M, 1.0)
    stamp, arrival, values = signals.in_order(
        topic, "gnss", np.stack([topic.column("x_m"), topic.column("y_m"), hdop], axis=1)
    )
    return GnssStream(seconds(stamp), seconds(arrival), values[:, 0], values[:, 1], values[:, 2])


def reference_stream(signals: Signals, part: m.ReferencePart) -> ReferenceStream:
    """Rear-axle poses in the frame of the recording, or moved to the origin that is stated."""
    topic = signals.index.topics[part.topic]
    names = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
    rows = np.stack([topic.column(name) for name in names], axis=1)
    with np.errstate(over="ignore"):
        length = np.linalg.norm(rows[:, 3:], axis=1)
    whole = np.abs(length - 1.0) < 0.1
    if lost := int(np.count_nonzero(~whole & np.isfinite(length))):
        signals.problems["reference_without_orientation"] += lost
    rows = np.column_stack([rows, _stated_sd(topic, part)])
    stamp, _, values = signals.in_order(
        topic, "reference", rows, whole | ~np.isfinite(length), optional=1
    )
    poses = _axle_poses(signals, topic, part, values[:, :-1])
    if part.origin is not None:
        o = part.origin
        place = rotate(poses[:, :2], o.yaw_rad) + np.array([o.east_m, o.north_m])
        poses = np.column_stack([place, poses[:, 2] + o.yaw_rad])
    poses[:, 2] = wrap_angle(poses[:, 2])
    return ReferenceStream(seconds(stamp), poses, values[:, -1])


def _stated_sd(topic: Topic, part: m.ReferencePart) -> Floats:
    if part.sd_m is not None:
        return np.full(len(topic.stamps_ns), part.sd_m)
    variance = (topic.column("var_x_m2") + topic.column("var_y_m2")) / 2.0
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(variance > 0, np.sqrt(np.abs(variance)), np.nan))


def _axle_poses(signals: Signals, topic: Topic, part: m.ReferencePart, values: Floats) -> Floats:
    """East, north and yaw of the rear axle, from the poses of another frame of the car."""
    child = part.frame or topic.child_frame_id or signals.vehicle.base or ""
    way = signals.vehicle.vehicle_from(child)
    quaternion = values[:, 3:] / np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    if way is None:
        if child:
            signals.notes.append(_UNKNOWN_FRAME.format(topic=topic.name, frame=child))
        way = np.eye(4)
    child_from_vehicle = np.linalg.inv(way)
    if np.allclose(child_from_vehicle[:3, :3], np.eye(3), atol=1e-12) and not np.any(
        child_from_vehicle[:2, 3]
    ):
        x, y, z, w = quaternion.T
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        return np.column_stack([values[:, :2], yaw])
    turns = rotation_from_quaternion(quaternion)
    axle = values[:, :3] + np.einsum("nij,j->ni", turns, child_from_vehicle[:3, 3])
    turns = turns @ child_from_vehicle[:3, :3]
    return np.column_stack([axle[:, :2], np.arctan2(turns[:, 1, 0], turns[:, 0, 0])])


def pole_scans(
    signals: Signals, topic: Topic, view: VisibleRegion | None
) -> tuple[Detections, ...]:
    """Scans of poles that were detected elsewhere; poles without a covariance are counted."""
    rows = np.stack([topic.column(name) for name in topic.columns], axis=1)
    x_m, y_m, var_x, var_y, cov, width, probability = rows.T
    usable = np.isfinite(rows[:, :5]).all(axis=1) & (var_x > 0) & (var_x * var_y > cov**2)
    if lost := int(np.count_nonzero(~usable)):
        signals.problems["poles_without_covariance"] += lost
    first = np.concatenate([[0], np.cumsum(topic.counts)])
    number = np.arange(len(topic.counts), dtype=np.float64)[:, None]
    stamp, arrival, order = signals.in_order(topic, "scans", number)
    covariance = np.stack([np.stack([var_x, cov], -1), np.stack([cov, var_y], -1)], axis=-2)
    scans = []
    for row, scan in enumerate(order[:, 0].astype(int)):
        own = np.arange(first[scan], first[scan + 1])
        own = own[usable[own]]
        scans.append(
            pole_detections(
                float(seconds(stamp[row : row + 1])[0]),
                float(seconds(arrival[row : row + 1])[0]),
                np.stack([x_m[own], y_m[own]], axis=1),
                covariance[own],
                width_m=width[own],
                probability=probability[own],
                view=view,
            )
        )
    return tuple(scans)
