"""The Foxglove WebSocket, spoken to as a viewer does."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from polemap.drivelog.errors import ConfigError, OutputError
from polemap.drivelog.frames import EarthFrame
from polemap.localize.output_filter.limiter import OutputPose
from polemap.tools.follow.address import parse_address
from polemap.tools.follow.engine import Tick
from polemap.tools.follow.server import SUBPROTOCOL, FoxgloveServer
from tests.city_maps import opened, write_city
from tests.localize.point_drives import street_drive
from tests.pole_maps import plain_map


def tick(stamp_s: float, place: tuple[float, float, float] = (458123.0, 5.43e6, 0.5)) -> Tick:
    covariance = np.diag([0.01, 0.04, 1e-4])
    answer = OutputPose(stamp_s, place, covariance, 8.0, 0.1, "", 0.0, 0.2)  # type: ignore[arg-type]
    return Tick(answer, 0.003, 2)


@pytest.fixture
def server() -> Iterator[FoxgloveServer]:
    made = FoxgloveServer(("127.0.0.1", 0), EarthFrame("utm", 32632), street_drive(2, 1.0).pole_map)
    yield made
    made.close()


def test_of_a_city_the_poles_around_are_shown_anew_on_the_way(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(0.0, 3000.0, (500, 2))
    city = opened(write_city(plain_map(points), tmp_path)["parquet"])
    server = FoxgloveServer(("127.0.0.1", 0), city.frame, city)
    shown: list[int] = []
    publish = server._publish
    server._publish = lambda topic, now_ns, message: (  # type: ignore[method-assign]
        shown.append(len(message.entities[0].cylinders)) if topic == "/map/poles" else None,
        publish(topic, now_ns, message),
    )
    try:
        with connect(server.url, subprotocols=[SUBPROTOCOL]) as viewer:  # type: ignore[list-item]
            viewer.recv(timeout=10)
            viewer.recv(timeout=10)
            for second in range(10):
                server.send(tick(second + 1.0, (500.0 + 100.0 * second, 1000.0, 0.0)))
    finally:
        server.close()
    assert 3 <= len(shown) <= 5
    assert all(0 < count < 500 for count in shown)


@pytest.fixture
def viewer(server: FoxgloveServer) -> Iterator[ClientConnection]:
    with connect(server.url, subprotocols=[SUBPROTOCOL]) as connection:  # type: ignore[list-item]
        yield connection


def channels_of(viewer: ClientConnection) -> dict[str, Any]:
    info = json.loads(viewer.recv(timeout=10))
    assert info["op"] == "serverInfo"
    advertised = json.loads(viewer.recv(timeout=10))
    assert advertised["op"] == "advertise"
    return {channel["topic"]: channel for channel in advertised["channels"]}


def subscribe(viewer: ClientConnection, number: int, channel: dict[str, Any]) -> None:
    request = {"op": "subscribe", "subscriptions": [{"id": number, "channelId": channel["id"]}]}
    viewer.send(json.dumps(request))


def decoded(channel: dict[str, Any], payload: bytes) -> Any:
    if channel["encoding"] == "json":
        return SimpleNamespace(**json.loads(payload))
    schema = Schema(1, channel["schema"].encode(), channel["schemaEncoding"], channel["schemaName"])
    decode = DecoderFactory().decoder_for("cdr", schema)
    assert decode is not None
    return decode(payload)


def test_a_viewer_gets_what_it_subscribes_to(
    server: FoxgloveServer, viewer: ClientConnection
) -> None:
    channels = channels_of(viewer)
    assert {"/localization/pose", "/tf", "/localization/fix", "/map/poles", "/polemap"} <= set(
        channels
    )
    server.send(tick(12.0))  # the poles and the car are kept for those who come later
    for number, topic in enumerate(channels):
        subscribe(viewer, number, channels[topic])
    found: dict[str, Any] = {}
    for _ in range(50):
        server.send(tick(12.5))
        try:
            message = viewer.recv(timeout=0.2)
        except TimeoutError:
            continue
        assert isinstance(message, bytes)
        code, number, stamp_ns = struct.unpack_from("<BIQ", message)
        topic = list(channels)[number]
        assert code == 1
        found[topic] = (stamp_ns, decoded(channels[topic], message[13:]))
        if len(found) == len(channels):
            break
    assert set(found) == set(channels)
    stamp_ns, pose = found["/localization/pose"]
    assert stamp_ns == 12_500_000_000
    assert pose.pose.pose.position.x == pytest.approx(23.0)  # from an origin near the car
    assert pose.pose.covariance[7] == pytest.approx(0.04)
    assert found["/map/poles"][1].entities[0].cylinders
    line = found["/polemap"][1]
    assert (line.healthy, line.frames_skipped, line.position_sd_m) == (True, 2, 0.2)
    assert found["/localization/fix"][1].latitude == pytest.approx(49.0, abs=0.1)


def test_a_viewer_that_asks_nonsense_is_counted_and_stays(
    server: FoxgloveServer, viewer: ClientConnection
) -> None:
    channels = channels_of(viewer)
    for request in ("nonsense", "[]", '{"op": "subscribe"}', "[" * 50_000,
                    '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
                    '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 99}]}',
                    '{"op": "getParameters"}'):  # fmt: skip
        viewer.send(request)
    subscribe(viewer, 7, channels["/polemap"])
    for _ in range(50):
        server.send(tick(1.0))
        try:
            assert viewer.recv(timeout=0.2)
            break
        except TimeoutError:
            continue
    assert server.counts["viewer_requests_unusable"] == 6
    viewer.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [7]}))


def test_a_viewer_that_does_not_read_costs_nobody_anything(
    server: FoxgloveServer, viewer: ClientConnection
) -> None:
    channels = channels_of(viewer)
    for number in range(40):  # every message forty times
        subscribe(viewer, number, channels["/localization/pose"])
    for number in range(20_000):
        server.send(tick(1.0 + 0.01 * number))
        if server.counts["viewer_messages_dropped"]:
            break
    assert server.counts["viewer_messages_dropped"] > 0


def test_another_protocol_is_refused(server: FoxgloveServer) -> None:
    with pytest.raises(InvalidStatus), connect(server.url):
        pass


def test_loopback_unless_told_otherwise(server: FoxgloveServer) -> None:
    assert parse_address("8765") == ("127.0.0.1", 8765)
    assert parse_address("0.0.0.0:8765") == ("0.0.0.0", 8765)
    assert parse_address("[::1]:80") == ("::1", 80)
    for wrong in ("", ":80", "host", "host:", "70000", "-1", "1.5"):
        with pytest.raises(ConfigError, match="expected"):
            parse_address(wrong)
    port = int(server.url.rsplit(":", 1)[1])
    with pytest.raises(OutputError, match="cannot be listened at"):
        FoxgloveServer(("127.0.0.1", port), EarthFrame("local", name="yard"), None)


def test_stamps_before_zero_are_not_sent(server: FoxgloveServer) -> None:
    server.send(tick(-5.0))
    assert not server.counts
