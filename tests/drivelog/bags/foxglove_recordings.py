"""Drives as MCAP files of Foxglove's own types, in protobuf and JSON."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import cv2
import mcap.writer
import numpy as np
from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClassesForFiles
from mcap_protobuf.schema import build_file_descriptor_set

from polemap.drivelog.drive import Drive
from polemap.drivelog.frames import geographic_from_grid
from tests.drivelog.bags.recordings import SECOND_NS, Ros, Said, ns, quaternion_of

_NUMBER, _TEXT, _BYTES, _UINT = (
    FieldDescriptorProto.TYPE_DOUBLE, FieldDescriptorProto.TYPE_STRING,
    FieldDescriptorProto.TYPE_BYTES, FieldDescriptorProto.TYPE_FIXED32,
)  # fmt: skip
_TIME = ".google.protobuf.Timestamp"
_FOXGLOVE: dict[str, list[tuple[str, Any, bool]]] = {
    "Vector3": [(name, _NUMBER, False) for name in "xyz"],
    "Quaternion": [(name, _NUMBER, False) for name in "xyzw"],
    "Pose": [("position", ".foxglove.Vector3", False),
             ("orientation", ".foxglove.Quaternion", False)],
    "PoseInFrame": [("timestamp", _TIME, False), ("frame_id", _TEXT, False),
                    ("pose", ".foxglove.Pose", False)],
    "FrameTransform": [("timestamp", _TIME, False), ("parent_frame_id", _TEXT, False),
                       ("child_frame_id", _TEXT, False),
                       ("translation", ".foxglove.Vector3", False),
                       ("rotation", ".foxglove.Quaternion", False)],
    "RawImage": [("timestamp", _TIME, False), ("frame_id", _TEXT, False),
                 ("width", _UINT, False), ("height", _UINT, False), ("encoding", _TEXT, False),
                 ("step", _UINT, False), ("data", _BYTES, False)],
    "CompressedImage": [("timestamp", _TIME, False), ("frame_id", _TEXT, False),
                        ("data", _BYTES, False), ("format", _TEXT, False)],
    "CameraCalibration": [("timestamp", _TIME, False), ("frame_id", _TEXT, False),
                          ("width", _UINT, False), ("height", _UINT, False),
                          ("distortion_model", _TEXT, False),
                          *((name, _NUMBER, True) for name in "DKRP")],
    "LocationFix": [("timestamp", _TIME, False), ("frame_id", _TEXT, False),
                    ("latitude", _NUMBER, False), ("longitude", _NUMBER, False),
                    ("altitude", _NUMBER, False), ("position_covariance", _NUMBER, True),
                    ("position_covariance_type", _UINT, False)],
}  # fmt: skip


def foxglove_types() -> dict[str, Any]:
    """Message classes of `_FOXGLOVE` by name."""
    file = FileDescriptorProto(name="foxglove.proto", package="foxglove", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    for name, fields in _FOXGLOVE.items():
        message = file.message_type.add(name=name)
        for number, (field, kind, repeated) in enumerate(fields, start=1):
            added = message.field.add(name=field, number=number)
            label = "LABEL_REPEATED" if repeated else "LABEL_OPTIONAL"
            added.label = getattr(FieldDescriptorProto, label)
            if isinstance(kind, str):
                added.type, added.type_name = FieldDescriptorProto.TYPE_MESSAGE, kind
            else:
                added.type = kind
    pool = DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    found: dict[str, Any] = GetMessageClassesForFiles([file.name], pool)
    return found


def foxglove_messages(drive: Drive) -> list[Said]:
    """Pictures, calibrations, mounting, fixes and reference as plain dictionaries."""
    said = []

    def add(log_s: float, stamp_s: float, topic: str, kind: str, **fields: Any) -> None:
        stamp = ns(stamp_s)
        time = {"sec": stamp // SECOND_NS, "nsec": stamp % SECOND_NS}
        said.append(Said(ns(log_s), topic, kind, {"timestamp": time, **fields}))

    rig = drive.rig
    assert rig is not None
    assert drive.reference is not None
    mount = rig.vehicle_from_camera
    start = drive.span_s[0]
    add(start, start, "/tf", "FrameTransform", parent_frame_id="rear_axle", child_frame_id="camera",
        translation=dict(zip("xyz", (mount.x_m, mount.y_m, mount.z_m), strict=True)),
        rotation=dict(zip("xyzw", quaternion_of(mount.rotation()), strict=True)))  # fmt: skip
    for row in range(len(drive.frame_stamps_s)):
        frame = drive.read_frame(row)
        for side in ("left", "right"):
            picture = getattr(frame, side)
            common = {"frame_id": "camera", "width": rig.width_px, "height": rig.height_px}
            if side == "left":
                add(frame.arrival_s, frame.stamp_s, "/cam/left/image_rect", "RawImage", **common,
                    encoding="mono8", step=rig.width_px, data=picture.tobytes())  # fmt: skip
            else:
                add(frame.arrival_s, frame.stamp_s, "/cam/right/image_rect", "CompressedImage",
                    frame_id="camera", format="png",
                    data=cv2.imencode(".png", picture)[1].tobytes())  # fmt: skip
            info = Ros().info(0, rig, side)
            add(frame.arrival_s, frame.stamp_s, f"/cam/{side}/calibration", "CameraCalibration",
                **common, distortion_model="plumb_bob",
                **{name: getattr(info, name.lower()).tolist() for name in "DKRP"})  # fmt: skip
    for stamp, (x, y, yaw) in zip(drive.reference.stamp_s, drive.reference.poses, strict=True):
        pose = {
            "position": {"x": x, "y": y, "z": 0.0},
            "orientation": {"x": 0.0, "y": 0.0, "z": np.sin(yaw / 2), "w": np.cos(yaw / 2)},
        }
        add(stamp, stamp, "/ground_truth", "PoseInFrame", frame_id="map", pose=pose)
    if drive.gnss is not None and drive.frame.is_utm:
        points = np.stack([drive.gnss.east_m, drive.gnss.north_m], axis=1)
        for row, (latitude, longitude) in enumerate(geographic_from_grid(drive.frame, points)):
            variance = (2.5 * float(drive.gnss.hdop[row])) ** 2
            add(drive.gnss.arrival_s[row], drive.gnss.stamp_s[row], "/fix", "LocationFix",
                frame_id="gnss", latitude=float(latitude), longitude=float(longitude), altitude=0.0,
                position_covariance=[variance, 0, 0, 0, variance, 0, 0, 0, 9.0],
                position_covariance_type=2)  # fmt: skip
    return sorted(said, key=lambda one: one.log_ns)


def write_foxglove(path: Path, said: Iterable[Said], encoding: str) -> Path:
    """A bare MCAP file of Foxglove's messages, `protobuf` or `json`."""
    types = foxglove_types()
    encode: Callable[[Said], bytes] = {"protobuf": lambda one: _protobuf(types, one),
                                       "json": _json}[encoding]  # fmt: skip
    with path.open("wb") as file:
        writer: Any = mcap.writer.Writer(file)
        writer.start()
        known: dict[str, int] = {}
        for number, one in enumerate(said):
            if one.topic not in known:
                name = f"foxglove.{one.type_name}"
                if encoding == "protobuf":
                    schema = build_file_descriptor_set(types[name]).SerializeToString()
                    number_of = writer.register_schema(name, "protobuf", schema)
                else:
                    number_of = writer.register_schema(name, "jsonschema", b'{"type": "object"}')
                known[one.topic] = writer.register_channel(one.topic, encoding, number_of)
            writer.add_message(known[one.topic], one.log_ns, encode(one), one.log_ns, number)
        writer.finish()
    return path


def _protobuf(types: dict[str, Any], one: Said) -> bytes:
    values = dict(one.content)
    time = values.pop("timestamp")
    values["timestamp"] = {"seconds": time["sec"], "nanos": time["nsec"]}
    return bytes(types[f"foxglove.{one.type_name}"](**values).SerializeToString())


def _json(one: Said) -> bytes:
    values = dict(one.content)
    if "data" in values:
        values["data"] = base64.b64encode(values["data"]).decode()
    return json.dumps(values).encode()
