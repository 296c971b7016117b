"""Memory and time on recordings that are larger than memory: pictures read when they are needed.

    python -m benchmarks.drivelog.large_logs --gigabytes 20

writes a recording of that size by repeating a stereo drive of noise at 10 Hz with wheel odometry,
IMU and reference, of each kind in turn, and deletes it afterwards. Every measurement is a process
of its own, so that its peak of memory is that of the work alone. `run` does it with 0.3 and 1.2 GB.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Figures, command_line

WIDTH_PX, HEIGHT_PX = 1242, 375
FRAME_NS, IMU_NS = 100_000_000, 10_000_000
SEQUENTIAL, RANDOM = 200, 50
_MEASURE = """
import json, resource, sys, time
import numpy as np
from pathlib import Path
from polemap.drivelog.readers.registry import open_drive

def peak_mb():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

import polemap.drivelog.readers.bags.reader
imported = peak_mb()
begin = time.perf_counter()
drive = open_drive(Path(sys.argv[1]))
opened = time.perf_counter() - begin
opened_mb = peak_mb()
frames = len(drive.frame_stamps_s)
begin = time.perf_counter()
for row in range(min({sequential}, frames)):
    drive.read_frame(row)
sequential = (time.perf_counter() - begin) / min({sequential}, frames)
rows = np.random.default_rng(0).integers(0, frames, {random})
begin = time.perf_counter()
for row in rows:
    drive.read_frame(int(row))
print(json.dumps({{
    "frames": frames, "open_s": opened, "sequential_ms": 1e3 * sequential,
    "random_ms": 1e3 * (time.perf_counter() - begin) / len(rows), "import_mb": imported,
    "open_mb": opened_mb, "peak_mb": peak_mb(),
}}))
"""
_AGAIN = """
import sys, time
from pathlib import Path
from polemap.drivelog.readers.registry import open_drive

begin = time.perf_counter()
open_drive(Path(sys.argv[1]))
print(time.perf_counter() - begin)
"""


def messages(count: int) -> Iterator[tuple[int, str, str, Any]]:
    """Log time, topic, type and content of `count` stereo frames and what comes between them."""
    from rosbags.typesys import Stores, get_typestore

    make = get_typestore(Stores.ROS2_HUMBLE).types
    rng = np.random.default_rng(1)
    pictures = [rng.integers(0, 255, HEIGHT_PX * WIDTH_PX).astype(np.uint8) for _ in range(8)]

    def header(stamp_ns: int, frame: str) -> Any:
        stamp = make["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
        return make["std_msgs/msg/Header"](stamp, frame)

    vector, point = make["geometry_msgs/msg/Vector3"], make["geometry_msgs/msg/Point"]
    turn = make["geometry_msgs/msg/Quaternion"]
    k = np.array([721.5, 0, 609.0, 0, 721.5, 172.0, 0, 0, 1])
    roi = make["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    for number in range(count):
        now = 1_600_000_000_000_000_000 + number * FRAME_NS
        for side in (0, 1):
            name = ("left", "right")[side]
            image = make["sensor_msgs/msg/Image"](
                header(now, "camera"), HEIGHT_PX, WIDTH_PX, "mono8", 0, WIDTH_PX,
                pictures[(2 * number + side) % len(pictures)],
            )  # fmt: skip
            yield now, f"/stereo/{name}/image_rect", "sensor_msgs/msg/Image", image
            p = np.array([721.5, 0, 609, -387.4 * side, 0, 721.5, 172, 0, 0, 0, 1, 0])
            info = make["sensor_msgs/msg/CameraInfo"](
                header(now, "camera"), HEIGHT_PX, WIDTH_PX, "plumb_bob", np.zeros(5), k,
                np.eye(3).ravel(), p, 0, 0, roi,
            )  # fmt: skip
            yield now, f"/stereo/{name}/camera_info", "sensor_msgs/msg/CameraInfo", info
        for step in range(FRAME_NS // IMU_NS):
            stamp = now + step * IMU_NS
            spin = vector(0.0, 0.0, 0.1)
            twist = make["geometry_msgs/msg/Twist"](vector(10.0, 0.0, 0.0), spin)
            content = make["geometry_msgs/msg/TwistStamped"](header(stamp, "base_link"), twist)
            yield stamp, "/wheel/twist", "geometry_msgs/msg/TwistStamped", content
            imu = make["sensor_msgs/msg/Imu"](
                header(stamp, "imu"), turn(0.0, 0.0, 0.0, 1.0), np.zeros(9), spin, np.zeros(9),
                vector(0.0, 0.0, 9.8), np.zeros(9),
            )  # fmt: skip
            yield stamp, "/imu/data", "sensor_msgs/msg/Imu", imu
        pose = make["geometry_msgs/msg/Pose"](point(number, 0.0, 0.0), turn(0.0, 0.0, 0.0, 1.0))
        reference = make["geometry_msgs/msg/PoseStamped"](header(now, "map"), pose)
        yield now, "/ground_truth", "geometry_msgs/msg/PoseStamped", reference


def write_mcap(path: Path, count: int, compression: str) -> Path:
    """A bare MCAP file of `count` frames."""
    from mcap.writer import CompressionType, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with path.open("wb") as file:
        writer: Any = Writer(file, compression=CompressionType[compression], enable_crcs=False)
        writer.start(profile="ros2")
        known: dict[str, int] = {}
        for log_ns, topic, kind, content in messages(count):
            if topic not in known:
                text = store.generate_msgdef(kind, ros_version=2)[0].encode()
                schema = writer.register_schema(kind, "ros2msg", text)
                known[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(store.serialize_cdr(content, kind))
            writer.add_message(known[topic], log_ns, data, log_ns)
        writer.finish()
    return path


def write_sqlite(path: Path, count: int) -> Path:
    """A rosbag2 folder with SQLite."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        known: dict[str, Any] = {}
        for log_ns, topic, kind, content in messages(count):
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(known[topic], log_ns, store.serialize_cdr(content, kind))
    return path


def write_rosbag1(path: Path, count: int) -> Path:
    """A ROS 1 bag."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    two, one = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS1_NOETIC)
    with Writer(path) as writer:
        known: dict[str, Any] = {}
        for log_ns, topic, kind, content in messages(count):
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=one)
            writer.write(known[topic], log_ns, two.cdr_to_ros1(
                two.serialize_cdr(content, kind), kind))  # fmt: skip
    return path


WRITERS: dict[str, Callable[[Path, int], Path]] = {
    "mcap": lambda folder, count: write_mcap(folder / "log.mcap", count, "NONE"),
    "mcap_lz4": lambda folder, count: write_mcap(folder / "log.mcap", count, "LZ4"),
    "sqlite3": lambda folder, count: write_sqlite(folder / "log", count),
    "rosbag1": lambda folder, count: write_rosbag1(folder / "log.bag", count),
}


def measure(kind: str, gigabytes: float, within: Path) -> dict[str, float]:
    """Write a recording, open it in a process of its own, delete it."""
    count = max(1, round(gigabytes * 1e9 / (2 * WIDTH_PX * HEIGHT_PX)))
    with tempfile.TemporaryDirectory(dir=within) as folder:
        begin = time.perf_counter()
        path = WRITERS[kind](Path(folder), count)
        written_s = time.perf_counter() - begin
        size = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())
        found: dict[str, float] = json.loads(_run(_MEASURE.format(
            sequential=SEQUENTIAL, random=RANDOM), path, Path(folder)))  # fmt: skip
        found["open_again_s"] = float(_run(_AGAIN, path, Path(folder)))
    return {"gigabytes": size / 1e9, "write_s": written_s, **found}


def _run(code: str, path: Path, folder: Path) -> str:
    """What a process of its own prints; indexes are kept in `folder`, so that none is there yet."""
    places = {"XDG_CACHE_HOME": str(folder / "cache"), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-c", code, str(path)]
    return subprocess.run(
        command, check=True, capture_output=True, text=True, env={**os.environ, **places}
    ).stdout


def run() -> Figures:
    """Peaks of memory of recordings of which one is four times as large."""
    figures: Figures = {}
    for kind in WRITERS:
        small, large = (measure(kind, size, Path(tempfile.gettempdir())) for size in (0.3, 1.2))
        growth = large["peak_mb"] - small["peak_mb"]
        figures[f"large_log_{kind}"] = {**large, "growth_mb": growth}
    return figures


def main() -> None:
    options = command_line(
        __doc__, gigabytes=20.0, kinds=list(WRITERS), folder=Path(tempfile.gettempdir())
    )
    for kind in options.kinds:
        found = measure(kind, options.gigabytes, options.folder)
        print(kind, json.dumps({name: round(value, 3) for name, value in found.items()}))


if __name__ == "__main__":
    main()
