"""Messages of a followed recording as samples, by the mapping of its topics."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from polemap.drivelog.detections import Detections, VisibleRegion
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame, grid_from_geographic
from polemap.drivelog.live.mcap_stream import StreamMessage
from polemap.drivelog.live.pending import PendingFrame
from polemap.drivelog.readers.bags import mapping as m
from polemap.drivelog.readers.bags.container import Channel
from polemap.drivelog.readers.bags.decoding import (
    UnknownTypeError,
    decoder_of,
    head_stamp_ns,
    stamp_ns,
)
from polemap.drivelog.readers.bags.described import pole_scan
from polemap.drivelog.readers.bags.fields import COLUMNS, by_path, extract_of
from polemap.drivelog.readers.bags.frames import PAIR_TOLERANCE_NS, decode_picture
from polemap.drivelog.readers.bags.odometry_signals import speed_factor
from polemap.drivelog.readers.bags.pictures import grey
from polemap.drivelog.readers.bags.types import kind_of
from polemap.drivelog.samples import GnssFix, Image, OdometrySample
from polemap.drivelog.streams import SD_AT_DILUTION_ONE_M
from polemap.parsing.errors import named
from polemap.stereo.rectify import Rectifier

Sample = OdometrySample | GnssFix | Detections | PendingFrame
# pictures that wait for their partner; a recorder writes those of one moment close together
_WAITING = 8
# times of recording this far from the stamps are of another clock
_ANOTHER_CLOCK_S = 60.0


class TopicSamples:
    """Turns messages into samples one by one.

    Attributes:
        counts: what was left out, by kind.
    """

    def __init__(
        self,
        mapping: m.Mapping,
        frame: EarthFrame,
        *,
        poles: str | None = None,
        view: VisibleRegion | None = None,
        rectifier: Rectifier | None = None,
    ) -> None:
        """`poles` is a topic of `polemap_msgs/PoleScan`; `view` what their detector can see."""
        self._mapping, self._frame, self._poles_topic = mapping, frame, poles
        self._view, self._rectifier = view, rectifier
        self._rates: float | None = None
        self._right_mps: float | None = None
        self._ahead_s: float | None = None
        self._waiting: dict[str, OrderedDict[int, tuple[Channel, bytes]]] = {
            "left": OrderedDict(), "right": OrderedDict(),
        }  # fmt: skip
        self._pairs = 0
        self.counts: Counter[str] = Counter()
        self._uses = _uses(mapping)
        tolerance = mapping.camera.pair_tolerance_s if mapping.camera else None
        self._tolerance_ns = PAIR_TOLERANCE_NS if tolerance is None else round(tolerance * 1e9)

    @property
    def topics(self) -> list[str]:
        """Every topic that is listened to."""
        return sorted({*self._uses, *([self._poles_topic] if self._poles_topic else [])})

    def log_s(self, log_s: float, stamp_s: float) -> float:
        """A time of recording on the clock of the stamps."""
        if self._ahead_s is None:
            ahead = log_s - stamp_s
            self._ahead_s = ahead if abs(ahead) > _ANOTHER_CLOCK_S else 0.0
        return log_s - self._ahead_s

    def samples(self, message: StreamMessage) -> Iterator[Sample]:
        """What a message says; `arrival_s` is its time of recording."""
        topic = message.channel.topic
        uses = self._uses.get(topic, ())
        if not uses and topic != self._poles_topic:
            return
        try:
            if uses and uses[0] in ("left", "right"):
                yield from self._picture(uses[0], message)
                return
            decoded = decoder_of(message.channel)(message.data)
        except UnknownTypeError:
            raise
        except InputError:
            self.counts[f"{topic} undecodable"] += 1
            return
        except Exception:  # generated code raises what it raises
            self.counts[f"{topic} undecodable"] += 1
            return
        stamp_s = stamp_ns(decoded) / 1e9 or message.log_s
        log_s = self.log_s(message.log_s, stamp_s)
        if topic == self._poles_topic:
            yield pole_scan(decoded, stamp_s, log_s, self._view)
            return
        for use in uses:
            sample = self._number(use, message.channel, decoded, stamp_s, log_s)
            if sample is not None:
                yield sample

    def _number(
        self, use: str, channel: Channel, decoded: Any, stamp_s: float, log_s: float
    ) -> Sample | None:
        if use == "yaw_rate":
            self._rates = self._turn(channel, decoded)
            return None
        if use == "gnss":
            return self._fix(channel, decoded, stamp_s, log_s)
        part = self._mapping.odometry
        if part is None:
            return None
        signal = part.right_wheel if use == "right_wheel" and part.right_wheel else part.speed
        speed = _value(signal, "speed_mps", channel, decoded)
        speed *= speed_factor(signal, part.wheel_radius_m)
        if use == "right_wheel":
            self._right_mps = speed
            return None
        if part.right_wheel is not None:
            if self._right_mps is None:
                self.counts["odometry_without_right_wheel"] += 1
                return None
            if part.track_m is not None:
                self._rates = (self._right_mps - speed) / part.track_m
            speed = (speed + self._right_mps) / 2.0
        elif (part.yaw_rate or part.speed).topic == part.speed.topic:
            self._rates = self._turn(channel, decoded)
        if self._rates is None:
            self.counts["odometry_without_yaw_rate"] += 1
            return None
        return OdometrySample(stamp_s, log_s, speed, self._rates)

    def _turn(self, channel: Channel, decoded: Any) -> float:
        part = self._mapping.odometry
        if part is None:
            return 0.0
        signal = part.yaw_rate or part.speed
        name = "z_radps" if kind_of(channel.type_name) == "imu" else "yaw_rate_radps"
        own_unit = signal.unit if signal.unit in m.TURN_UNITS else "rad/s"
        scale = signal.scale if part.yaw_rate is not None else 1.0
        return _value(signal, name, channel, decoded) * m.TURN_UNITS[own_unit or "rad/s"] * scale

    def _fix(self, channel: Channel, decoded: Any, stamp_s: float, log_s: float) -> GnssFix | None:
        kind = kind_of(channel.type_name)
        values = _columns(channel, decoded)
        if kind == "gnss":
            if values["status"] < 0:
                self.counts["gnss_without_fix"] += 1
                return None
            latitude, longitude = values["latitude_deg"], values["longitude_deg"]
            if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
                self.counts["gnss_out_of_range"] += 1
                return None
            east, north = grid_from_geographic(self._frame, [latitude], [longitude])[0]
            variance = (values["var_east_m2"] + values["var_north_m2"]) / 2.0
        else:
            east, north = values["x_m"], values["y_m"]
            variance = (values["var_x_m2"] + values["var_y_m2"]) / 2.0
        known = np.isfinite(variance) and variance > 0
        hdop = float(np.sqrt(variance)) / SD_AT_DILUTION_ONE_M if known else 1.0
        return GnssFix(stamp_s, log_s, float(east), float(north), hdop)

    def _picture(self, side: str, message: StreamMessage) -> Iterator[PendingFrame]:
        """The pair that this picture completes; one whose partner never comes is counted."""
        decoded_ns = _header_ns(message)
        mine, other = self._waiting[side], self._waiting["right" if side == "left" else "left"]
        mine[decoded_ns] = (message.channel, message.data)
        if len(mine) > _WAITING:
            mine.popitem(last=False)
            self.counts[f"{side}_pictures_without_partner"] += 1
        near = min(other, key=lambda stamp: abs(stamp - decoded_ns), default=None)
        if near is None or abs(near - decoded_ns) > self._tolerance_ns:
            return
        pair = {side: mine.pop(decoded_ns), "right" if side == "left" else "left": other.pop(near)}
        stamp_s = (decoded_ns if side == "left" else near) / 1e9
        log_s = self.log_s(message.log_s, stamp_s)
        self._pairs += 1
        yield PendingFrame(stamp_s, log_s, self._pairs - 1, self._loader(pair))

    def _loader(self, pair: dict[str, tuple[Channel, bytes]]) -> Callable[[], tuple[Image, Image]]:
        def load() -> tuple[Image, Image]:
            pictures = []
            for side in ("left", "right"):
                channel, data = pair[side]
                with named(channel.topic, InputError, "picture"):
                    message = decode_picture(channel, data, channel.topic)
                    pictures.append(grey(message, channel.topic))
            left, right = pictures
            return self._rectifier.rectify(left, right) if self._rectifier else (left, right)

        return load


def _uses(mapping: m.Mapping) -> dict[str, tuple[str, ...]]:
    """What each topic is used for."""
    found: dict[str, tuple[str, ...]] = {}

    def add(topic: str, use: str) -> None:
        found[topic] = (*found.get(topic, ()), use)

    if mapping.odometry is not None:
        turn = mapping.odometry.yaw_rate
        if turn is not None and turn.topic != mapping.odometry.speed.topic:
            add(turn.topic, "yaw_rate")
        if mapping.odometry.right_wheel is not None:
            add(mapping.odometry.right_wheel.topic, "right_wheel")
        add(mapping.odometry.speed.topic, "speed")
    if mapping.gnss is not None:
        add(mapping.gnss.topic, "gnss")
    if mapping.camera is not None:
        add(mapping.camera.left.image, "left")
        add(mapping.camera.right.image, "right")
    return found


def _value(signal: m.Signal, name: str, channel: Channel, decoded: Any) -> float:
    """The number of a signal, or the mean of its several fields."""
    if signal.fields:
        return float(np.mean(by_path(signal.fields)(decoded)))
    values = _columns(channel, decoded)
    if name not in values:
        name = "value" if "value" in values else name
    if name not in values:
        raise UnknownTypeError(
            f"{channel.topic}: its messages ({channel.type_name}) have no {name}; name a topic "
            "that has in a mapping (--topics)"
        )
    return float(values[name])


def _columns(channel: Channel, decoded: Any) -> dict[str, float]:
    kind = kind_of(channel.type_name)
    extract = extract_of(kind) if kind is not None else None
    if kind is None or extract is None:
        raise UnknownTypeError(
            f"{channel.topic}: messages of type {channel.type_name[:80]} cannot be used"
        )
    return dict(zip(COLUMNS[kind], map(float, extract(decoded)), strict=True))


def _header_ns(message: StreamMessage) -> int:
    head = head_stamp_ns(message.channel)
    if head is not None:
        return head(message.data)
    return stamp_ns(decode_picture(message.channel, message.data, message.channel.topic))
