"""Speed and yaw rate of the rear axle from the topics that a mapping names."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.bags import mapping as m
from polemap.drivelog.readers.bags.clocks import seconds
from polemap.drivelog.readers.bags.index import Topic
from polemap.drivelog.readers.bags.signals import Integers, Signals
from polemap.drivelog.streams import OdometryStream

Floats = NDArray[np.float64]


def odometry_stream(signals: Signals, part: m.OdometryPart, wheelbase_m: float) -> OdometryStream:
    """Speed and yaw rate of the rear axle."""
    topics = signals.index.topics
    topic = topics[part.speed.topic]
    speed = _speed(topic, part.speed, part.wheel_radius_m)
    if part.right_wheel is not None:
        return _two_wheels(signals, part, part.right_wheel, speed, wheelbase_m)
    turn = part.yaw_rate or part.speed
    if turn.topic == part.speed.topic:
        yaw_rate = _yaw_rate(topic, turn, signals, speed, wheelbase_m)
        stamp, arrival, both = signals.in_order(
            topic, "odometry", np.stack([speed, yaw_rate], axis=1)
        )
    else:
        stamp, arrival, both = signals.in_order(topic, "odometry", speed[:, None])
        other = topics[turn.topic]
        rates = _yaw_rate(other, turn, signals, None, wheelbase_m)
        stamp, arrival, both = _joined(
            signals, (stamp, arrival, both), signals.in_order(other, "yaw_rate", rates[:, None])
        )
    values = both[:, 0], both[:, 1]
    if topic.child_frame_id and not part.speed.fields:
        values = _at_axle(signals, topic, *values)
    return OdometryStream(seconds(stamp), seconds(arrival), *values)


def _two_wheels(
    signals: Signals, part: m.OdometryPart, right: m.Signal, left: Floats, wheelbase_m: float
) -> OdometryStream:
    """Mean of the wheels of an axle at the stamps of the left one, and their difference.

    v = (v_left + v_right) / 2, yaw rate = (v_right - v_left) / track, for wheels that roll.
    """
    topics = signals.index.topics
    other = topics[right.topic]
    speed = _speed(other, right, part.wheel_radius_m)
    wheels = signals.in_order(topics[part.speed.topic], "odometry", left[:, None])
    stamp, arrival, both = _joined(
        signals, wheels, signals.in_order(other, "right_wheel", speed[:, None]), "right_wheel"
    )
    mean = both.mean(axis=1)
    if part.track_m is not None:
        rate = (both[:, 1] - both[:, 0]) / part.track_m
        return OdometryStream(seconds(stamp), seconds(arrival), mean, rate)
    if part.yaw_rate is None:
        raise InputError("odometry.right_wheel: needs track_m, or yaw_rate from another topic")
    turning = topics[part.yaw_rate.topic]
    rates = _yaw_rate(turning, part.yaw_rate, signals, None, wheelbase_m)
    stamp, arrival, both = _joined(
        signals,
        (stamp, arrival, mean[:, None]),
        signals.in_order(turning, "yaw_rate", rates[:, None]),
    )
    return OdometryStream(seconds(stamp), seconds(arrival), both[:, 0], both[:, 1])


def _speed(topic: Topic, signal: m.Signal, wheel_radius_m: float | None) -> Floats:
    names = signal.fields or ("speed_mps",)
    if signal.fields == () and topic.kind == "joints":
        names = topic.columns
    elif signal.fields == () and topic.kind == "number":
        names = ("value",)
    speed = np.mean([topic.column(name) for name in names], axis=0)
    return np.asarray(speed * speed_factor(signal, wheel_radius_m))


def speed_factor(signal: m.Signal, wheel_radius_m: float | None) -> float:
    """What a number of a signal is multiplied by to be a speed in m/s."""
    unit = signal.unit or "m/s"
    factor = m.SPEED_UNITS.get(unit)
    if factor is None:
        factor = m.TURN_UNITS[unit] * float(wheel_radius_m or 0.0)
    return factor * signal.scale


def _yaw_rate(
    topic: Topic, signal: m.Signal, signals: Signals, speed: Floats | None, wheelbase_m: float
) -> Floats:
    factor = m.TURN_UNITS[signal.unit if signal.unit in m.TURN_UNITS else "rad/s"] * signal.scale
    if signal.fields:
        return np.asarray(np.mean([topic.column(f) for f in signal.fields], axis=0) * factor)
    if topic.kind == "imu":
        rates = np.stack([topic.column(name) for name in topic.columns], axis=1)
        way = signals.vehicle.vehicle_from(topic.frame_id)
        if way is None:
            signals.notes.append(
                f"{topic.name}: no TF leads to '{topic.frame_id}': its z axis is taken to point up"
            )
            return np.asarray(rates[:, 2] * factor)
        return np.asarray(rates @ way[2, :3] * factor)
    if topic.kind == "ackermann":
        if speed is None:
            speed = topic.column("speed_mps")
        return np.asarray(speed * np.tan(topic.column("road_wheel_angle_rad") * signal.scale)
                          / wheelbase_m)  # fmt: skip
    if "yaw_rate_radps" in topic.columns:
        return np.asarray(topic.column("yaw_rate_radps") * factor)
    raise InputError(
        f"{topic.name}: its messages ({topic.channel.type_name}) have no yaw rate; name its topic "
        "as odometry.yaw_rate in a mapping"
    )


def _joined(
    signals: Signals,
    speed: tuple[Integers, Integers, Floats],
    turn: tuple[Integers, Integers, Floats],
    name: str = "yaw_rate",
) -> tuple[Integers, Integers, Floats]:
    """Values `name` between samples at the stamps of the speeds; known when the later arrived."""
    if not len(turn[0]):
        raise InputError(f"odometry.{name}: its topic holds no message that can be used")
    inside = (speed[0] >= turn[0][0]) & (speed[0] <= turn[0][-1])
    if lost := int(np.count_nonzero(~inside)):
        signals.problems[f"odometry_without_{name}"] += lost
    stamp, arrival, values = (part[inside] for part in speed)
    after = np.clip(np.searchsorted(turn[0], stamp), 0, len(turn[0]) - 1)
    rate = np.interp(seconds(stamp), seconds(turn[0]), turn[2][:, 0])
    return stamp, np.maximum(arrival, turn[1][after]), np.column_stack([values[:, 0], rate])


def _at_axle(
    signals: Signals, topic: Topic, speed: Floats, yaw_rate: Floats
) -> tuple[Floats, Floats]:
    """From where the twist is measured to the rear axle: v_axle = v + r y, y to the left."""
    way = signals.vehicle.vehicle_from(topic.child_frame_id)
    if way is None or way[1, 3] == 0.0:
        return speed, yaw_rate
    return speed + yaw_rate * way[1, 3], yaw_rate
