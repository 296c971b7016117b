"""A Foxglove WebSocket: the pose, the car and the map's poles to every viewer that connects.

Source: Foxglove WebSocket protocol, subprotocol `foxglove.websocket.v1`: the server tells what it
is and which channels it has, a viewer subscribes, and messages go out as binary frames with the
subscription and the time in nanoseconds before the payload.
"""

from __future__ import annotations

import json
import struct
from collections import Counter, deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from threading import Condition, Thread
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError, OutputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.writers.ros import messages as ros
from polemap.drivelog.writers.ros.mcap_file import nanoseconds
from polemap.drivelog.writers.ros.types import message_types, type_of
from polemap.extras import need
from polemap.map.city.city_map import CityMap, along
from polemap.map.pole_map import PoleMap
from polemap.tools.follow.engine import Tick
from polemap.tools.follow.lines import tick_values
from polemap.tools.recording.foxglove_shapes import car_message, poles_message
from polemap.tools.recording.scene import ORIGIN_STEP_M, poles_of
from polemap.vehicle.pose import pose_rotation

Floats = NDArray[np.float64]

SUBPROTOCOL = "foxglove.websocket.v1"
_HEAD = struct.Struct("<BIQ")
_MESSAGE_DATA = 1
# messages that wait for a viewer which reads too slowly; half a second of all channels
_WAITING = 200
_LARGEST_REQUEST = 1 << 20
# channels that keep their last message for viewers that come later
_LATCHED = ("/map/poles", "/car")
# of a city the poles around are shown, anew after half of the way
_AROUND_M = 400.0


@dataclass(slots=True, eq=False)
class _Viewer:
    """A viewer that is connected: its subscriptions, and the messages that wait for it."""

    subscriptions: dict[int, set[int]] = field(default_factory=dict)
    waiting: deque[bytes] = field(default_factory=lambda: deque(maxlen=_WAITING))
    ready: Condition = field(default_factory=Condition)
    open: bool = True


class FoxgloveServer:
    """Serves channels; `send` never waits for a viewer.

    Attributes:
        counts: viewers that came, messages dropped because one read too slowly.
    """

    def __init__(
        self, address: tuple[str, int], frame: EarthFrame, pole_map: PoleMap | CityMap | None
    ):
        """Listen at `address`.

        Raises:
            OutputError: the port is taken, or may not be listened at.
            MissingExtraError: websockets or rosbags is not installed.
        """
        self._frame, self._pole_map = frame, pole_map
        self._origin: Floats | None = None
        self._shown_at_m = np.zeros(2)
        self._channels: dict[str, dict[str, Any]] = {}
        self._latched: dict[int, tuple[int, bytes]] = {}
        self._viewers: set[_Viewer] = set()
        self._lock = Condition()
        self.counts: Counter[str] = Counter()
        self._announce()
        sync: Any = need("websockets.sync.server")
        try:
            self._server = sync.serve(
                self._serve, *address, subprotocols=[SUBPROTOCOL], max_size=_LARGEST_REQUEST,
                select_subprotocol=_select, compression=None,
            )  # fmt: skip
        except OSError as error:
            raise OutputError(
                f"--serve {address[0]}:{address[1]}: cannot be listened at ({error.strerror})"
            ) from error
        Thread(target=self._server.serve_forever, name="foxglove", daemon=True).start()

    @property
    def url(self) -> str:
        """What a viewer connects to."""
        host, port = self._server.socket.getsockname()[:2]
        return f"ws://{f'[{host}]' if ':' in host else host}:{port}"

    def send(self, tick: Tick) -> None:
        """Give an answer to every viewer that has subscribed to one of its channels."""
        answer = tick.answer
        stamp = answer.stamp_s
        try:
            now_ns = nanoseconds(stamp, "a tick")
        except InputError:
            return  # stamps before zero: Foxglove has no number for them
        if self._origin is None:
            self._place(np.array(answer.pose[:2]), stamp, now_ns)
        if not self._viewers or self._origin is None:
            return
        moved_m = float(np.hypot(*(np.array(answer.pose[:2]) - self._shown_at_m)))
        if isinstance(self._pole_map, CityMap) and moved_m > _AROUND_M / 2:
            self._show_poles(np.array(answer.pose[:2]), stamp, now_ns)
        pose = np.array(answer.pose)
        pose[:2] -= self._origin
        turn = pose_rotation(float(pose[2]))
        self._publish(
            "/localization/pose", now_ns,
            ros.odometry(stamp, ros.MAP, pose, answer.covariance, answer.speed_mps,
                         answer.yaw_rate_radps),
        )  # fmt: skip
        car = ros.transform(stamp, ros.MAP, ros.VEHICLE, (*pose[:2], 0.0), turn)
        self._publish("/tf", now_ns, ros.transforms([car]))
        if "latitude_deg" in (values := tick_values(tick, self._frame)):
            fix = ros.nav_sat_fix(
                stamp, values["latitude_deg"], values["longitude_deg"], values["position_sd_m"]
            )
            self._publish("/localization/fix", now_ns, fix)
        self._put("/polemap", now_ns, json.dumps(values).encode("utf-8"))

    def close(self) -> None:
        """Let every viewer go."""
        with self._lock:
            viewers = list(self._viewers)
        for viewer in viewers:
            with viewer.ready:
                viewer.open = False
                viewer.ready.notify()
        self._server.shutdown()

    def _announce(self) -> None:
        types = message_types()
        kinds = {
            "/localization/pose": "nav_msgs/msg/Odometry",
            "/tf": "tf2_msgs/msg/TFMessage",
            **({"/localization/fix": "sensor_msgs/msg/NavSatFix"} if self._frame.is_utm else {}),
            "/map/poles": "foxglove_msgs/msg/SceneUpdate",
            "/car": "foxglove_msgs/msg/SceneUpdate",
        }
        for number, (topic, kind) in enumerate(kinds.items(), start=1):
            self._channels[topic] = {
                "id": number, "topic": topic, "encoding": "cdr", "schemaName": kind,
                "schema": types.definition(kind), "schemaEncoding": "ros2msg",
            }  # fmt: skip
        self._channels["/polemap"] = {
            "id": len(kinds) + 1, "topic": "/polemap", "encoding": "json",
            "schemaName": "polemap.Pose", "schema": json.dumps({"type": "object"}),
            "schemaEncoding": "jsonschema",
        }  # fmt: skip

    def _place(self, first_m: Floats, stamp_s: float, now_ns: int) -> None:
        """Draw from an origin near the first pose, as recordings do."""
        origin = np.floor(first_m / ORIGIN_STEP_M) * ORIGIN_STEP_M
        self._origin = origin if self._frame.is_utm else np.zeros(2)
        self._publish("/car", now_ns, car_message(stamp_s))
        if self._pole_map is not None:
            self._show_poles(first_m, stamp_s, now_ns)

    def _show_poles(self, place_m: Floats, stamp_s: float, now_ns: int) -> None:
        """The map, or of a city what lies around."""
        if self._pole_map is None or self._origin is None:
            return
        self._shown_at_m = place_m
        poles = poles_of(along(self._pole_map, place_m, _AROUND_M), self._origin)
        self._publish("/map/poles", now_ns, poles_message(poles, self._frame, stamp_s))

    def _publish(self, topic: str, now_ns: int, message: Any) -> None:
        channel = self._channels[topic]
        if channel["schemaName"] != type_of(message):
            raise ValueError(f"{topic} carries {channel['schemaName']}")
        self._put(topic, now_ns, message_types().serialize(message))

    def _put(self, topic: str, now_ns: int, payload: bytes) -> None:
        channel: int = self._channels[topic]["id"]
        if topic in _LATCHED:
            self._latched[channel] = (now_ns, payload)
        with self._lock:
            viewers = list(self._viewers)
        for viewer in viewers:
            self._queue(viewer, channel, now_ns, payload)

    def _queue(self, viewer: _Viewer, channel: int, now_ns: int, payload: bytes) -> None:
        with viewer.ready:
            for subscription in viewer.subscriptions.get(channel, ()):
                if len(viewer.waiting) == _WAITING:
                    self.counts["viewer_messages_dropped"] += 1
                viewer.waiting.append(_HEAD.pack(_MESSAGE_DATA, subscription, now_ns) + payload)
            viewer.ready.notify()

    # one thread a viewer reads, one writes

    def _serve(self, connection: Any) -> None:
        closed: Any = need("websockets.exceptions").ConnectionClosed
        viewer = _Viewer()
        with suppress(closed):
            connection.send(
                json.dumps(
                    {"op": "serverInfo", "name": "polemap", "capabilities": [],
                     "supportedEncodings": ["cdr", "json"], "metadata": {}}
                )
            )  # fmt: skip
            connection.send(
                json.dumps({"op": "advertise", "channels": list(self._channels.values())})
            )
            with self._lock:
                self._viewers.add(viewer)
                self.counts["viewers"] += 1
            writer = Thread(target=self._write, args=(connection, viewer, closed), daemon=True)
            writer.start()
            for request in connection:
                self._answer(viewer, request)
        with self._lock:
            self._viewers.discard(viewer)
        with viewer.ready:
            viewer.open = False
            viewer.ready.notify()

    def _write(self, connection: Any, viewer: _Viewer, closed: Any) -> None:
        with suppress(closed, OSError):
            while True:
                with viewer.ready:
                    while not viewer.waiting and viewer.open:
                        viewer.ready.wait()
                    if not viewer.open:
                        connection.close()
                        return
                    message = viewer.waiting.popleft()
                connection.send(message)

    def _answer(self, viewer: _Viewer, request: Any) -> None:
        """Take a subscription up or back; what else a viewer may ask for is not offered."""
        try:
            asked: Any = json.loads(request) if isinstance(request, str) else {}
            if asked.get("op") == "subscribe":
                for one in asked["subscriptions"]:
                    self._subscribe(viewer, one)
            elif asked.get("op") == "unsubscribe":
                with viewer.ready:
                    gone = {int(number) for number in asked["subscriptionIds"]}
                    for channel, numbers in viewer.subscriptions.items():
                        viewer.subscriptions[channel] = numbers - gone
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            self.counts["viewer_requests_unusable"] += 1

    def _subscribe(self, viewer: _Viewer, one: Mapping[str, Any]) -> None:
        channel, number = int(one["channelId"]), int(one["id"])
        if not 0 <= number < 2**32 or channel > len(self._channels):
            raise ValueError("no such channel")
        with viewer.ready:
            viewer.subscriptions.setdefault(channel, set()).add(number)
        if channel in self._latched:
            now_ns, payload = self._latched[channel]
            with viewer.ready:
                viewer.waiting.append(_HEAD.pack(_MESSAGE_DATA, number, now_ns) + payload)
                viewer.ready.notify()


def _select(connection: Any, offered: list[str]) -> str | None:
    """The protocol that is spoken here; newer viewers offer others besides."""
    if SUBPROTOCOL in offered:
        return SUBPROTOCOL
    negotiation: Any = need("websockets.exceptions")
    raise negotiation.NegotiationError(f"this server speaks {SUBPROTOCOL}")
