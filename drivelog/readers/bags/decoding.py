"""From the bytes of a message to an object with its fields, by the definition in the recording."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

from polemap.drivelog.errors import InputError
from polemap.drivelog.readers.bags.container import Channel
from polemap.drivelog.readers.bags.types import canonical
from polemap.errors import PolemapError
from polemap.extras import need
from polemap.parsing.errors import short

Decode = Callable[[bytes], Any]

# of no distribution, but what Ackermann cars publish; recordings before ROS 2 Iron bring no
# definitions. Source: ros-drivers/ackermann_msgs
_ACKERMANN = (
    "float32 steering_angle\nfloat32 steering_angle_velocity\nfloat32 speed\n"
    "float32 acceleration\nfloat32 jerk\n"
)
_ACKERMANN_STAMPED = "std_msgs/Header header\nackermann_msgs/AckermannDrive drive\n"
_LARGEST_MESSAGE = 1 << 30


class UnknownTypeError(InputError):
    """A type whose definition is not in the recording and not of a ROS distribution."""


def decoder_of(channel: Channel) -> Decode:
    """What turns the bytes of a channel's messages into objects.

    Raises:
        UnknownTypeError: nothing here knows the encoding or the type.
    """
    decode = _decoder_of(channel)
    if not channel.zstd:
        return decode
    return lambda data: decode(unpacked(data))


def unpacked(data: bytes, at_most: int = _LARGEST_MESSAGE) -> bytes:
    """A message that was compressed by itself, or its first bytes."""
    with need("zstandard").ZstdDecompressor().stream_reader(data) as stream:
        return bytes(stream.read(at_most))


@lru_cache(maxsize=256)
def _decoder_of(channel: Channel) -> Decode:
    try:
        if channel.encoding in ("cdr", "ros1"):
            return _ros(channel)
        if channel.encoding == "protobuf":
            return _protobuf(channel)
    except PolemapError:
        raise
    except Exception as error:
        # the parsers of definitions raise what their grammars raise
        raise UnknownTypeError(
            f"{channel.topic}: the definition of {channel.type_name} cannot be read "
            f"({short(error)})"
        ) from error
    if channel.encoding == "json":
        return _json
    raise UnknownTypeError(
        f"{channel.topic}: messages are encoded as '{channel.encoding[:20]}', which is unknown "
        "(known: cdr, ros1, protobuf, json)"
    )


def _ros(channel: Channel) -> Decode:
    types: Any = need("rosbags.typesys")
    name = channel.type_name
    if channel.schema:
        store = types.get_typestore(types.Stores.EMPTY)
        text = channel.schema.decode("utf-8", "replace")
        if channel.schema_encoding == "ros2idl":
            store.register(types.get_types_from_idl(text))
        else:
            store.register(types.get_types_from_msg(text, name))
    else:
        ros1 = channel.encoding == "ros1"
        store = types.get_typestore(types.Stores.ROS1_NOETIC if ros1 else types.Stores.ROS2_HUMBLE)
        for known, text in (("AckermannDrive", _ACKERMANN), ("AckermannDriveStamped",
                                                            _ACKERMANN_STAMPED)):  # fmt: skip
            store.register(types.get_types_from_msg(text, f"ackermann_msgs/msg/{known}"))
    if name not in store.fielddefs:
        raise UnknownTypeError(
            f"{channel.topic}: the recording holds no definition of {name}, and no ROS "
            "distribution does; record with a storage that keeps definitions (MCAP, or ROS 2 Iron "
            "and later)"
        )
    if channel.encoding == "ros1":
        return lambda data: store.deserialize_ros1(data, name)
    return lambda data: store.deserialize_cdr(data, name)


def _protobuf(channel: Channel) -> Decode:
    records, decoding = need("mcap.records"), need("mcap_protobuf.decoder")
    schema = records.Schema(1, channel.schema, channel.schema_encoding, channel.type_name)
    decode = decoding.DecoderFactory().decoder_for("protobuf", schema)
    if decode is None:
        raise UnknownTypeError(
            f"{channel.topic}: Protobuf messages without their schema; record with one"
        )
    return decode  # type: ignore[no-any-return]


def _json(data: bytes) -> Any:
    return json.loads(data, object_hook=lambda values: SimpleNamespace(**values))


def stamp_ns(message: Any) -> int:
    """The stamp in a message's header, or its `timestamp`; 0 where it has none."""
    header = getattr(message, "header", None)
    stamp = getattr(header, "stamp", None) if header is not None else None
    if stamp is None:
        stamp = getattr(message, "timestamp", None)
    if stamp is None:
        return 0
    for seconds, nanoseconds in (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs"),
                                 ("seconds", "nanos")):  # fmt: skip
        if hasattr(stamp, seconds) and hasattr(stamp, nanoseconds):
            return int(getattr(stamp, seconds)) * 1_000_000_000 + int(getattr(stamp, nanoseconds))
    return 0


def head_stamp_ns(channel: Channel) -> Callable[[bytes], int] | None:
    """What reads the stamp from a message's first bytes; None where it may stand anywhere.

    In CDR and in ROS 1 the fields stand in the order of the definition, the header first.
    """
    foxglove = canonical(channel.type_name).startswith("foxglove/")
    if channel.encoding == "cdr":
        return _cdr_stamp if not channel.zstd else lambda data: _cdr_stamp(unpacked(data, 16))
    if channel.encoding == "ros1" and not foxglove:
        return _ros1_stamp
    return None


def _cdr_stamp(data: bytes) -> int:
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _ros1_stamp(data: bytes) -> int:
    _, seconds, nanoseconds = struct.unpack_from("<III", data)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
