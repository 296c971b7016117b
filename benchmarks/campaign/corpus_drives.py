"""Valid files of drives in their forms: KITTI, recordings, logs and calibrations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial, reduce
from operator import xor
from pathlib import Path
from typing import Any

import pandas as pd
from rosbags.typesys import Stores

from polemap.drivelog.drive import Drive
from polemap.drivelog.logs.convert import convert_logs
from polemap.drivelog.logs.mapping import LogMapping, read_log_mapping
from polemap.drivelog.readers.bags import reader as log_reader
from polemap.drivelog.readers.bags.describe import describe_topics
from polemap.drivelog.readers.bags.describe import write_mapping as write_topics
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.writers.kitti_odometry import write_kitti_odometry
from polemap.electric.io import read_signal_log
from polemap.simulate.kitti_raw_layout import write_kitti_raw
from polemap.stereo.io import read_calibration, read_kitti_calibration
from tests.drivelog.bags import foxglove_recordings, recordings
from tests.stereo.calibrations import (
    make_calibration,
    opencv_values,
    write_kalibr,
    write_kitti,
    write_opencv,
)

Add = Callable[[str, Path, Callable[[], Any]], None]


def open_whole(path: Path) -> None:
    use_whole(open_drive(path))


def use_whole(drive: Drive) -> None:
    """What every command does with a drive, but for its pictures."""
    list(replace(drive, images=None).samples())
    if drive.has_frames:
        drive.read_frame(0)


def add_recordings(folder: Path, drive: Drive, add: Add) -> None:
    """Every container with every encoding; damage of one is told or left out, never a crash."""
    place = folder / "recordings"
    place.mkdir()
    ros, one = recordings.Ros(), recordings.Ros(Stores.ROS1_NOETIC)
    said, said_one = (recordings.ros_messages(drive, made) for made in (ros, one))
    foxglove = foxglove_recordings.foxglove_messages(drive)
    made = {
        "bag": recordings.write_rosbag1(place / "a.bag", said_one, one),
        "bag lz4": recordings.write_rosbag1(place / "b.bag", said_one, one, "LZ4"),
        "mcap plain": recordings.write_mcap(place / "c.mcap", said, ros, "NONE"),
        "mcap zstd": recordings.write_mcap(place / "d.mcap", said, ros, "ZSTD"),
        "mcap protobuf": foxglove_recordings.write_foxglove(place / "e.mcap", foxglove, "protobuf"),
        "mcap json": foxglove_recordings.write_foxglove(place / "f.mcap", foxglove, "json"),
    }
    for name, path in made.items():
        add(f"recordings/{name}", path, partial(_open_recording, path))
    two = recordings.write_rosbag2(place / "two", said, ros, "SQLITE3")
    for file in (two / "two.db3", two / "metadata.yaml"):
        add(f"recordings/{file.name}", file, partial(_open_recording, two))
    topics = place / "topics.yaml"
    _, guessed = log_reader.survey(made["mcap zstd"])
    write_topics(guessed.mapping, made["mcap zstd"], topics)
    add("recordings/topics.yaml", topics, partial(_open_recording, made["mcap zstd"], topics))


def _open_recording(path: Path, topics: Path | None = None) -> None:
    # files are written faster than their times tell
    log_reader.forget()
    index, guessed = log_reader.survey(path, topics)
    describe_topics(index, guessed)
    use_whole(open_drive(path, topics=topics))


def add_kitti(folder: Path, drive: Drive, add: Add) -> None:
    odometry = write_kitti_odometry(drive, folder / "kitti")
    for file in (odometry / "calib.txt", odometry / "times.txt",
                 folder / "kitti" / "poses" / "00.txt"):  # fmt: skip
        add(f"kitti/{file.name}", file, lambda: use_whole(open_drive(odometry)))
    raw = write_kitti_raw(drive, folder / "2011_09_26")
    files = (*raw.parent.glob("calib*.txt"), raw / "oxts" / "timestamps.txt",
             raw / "oxts" / "data" / f"{0:010d}.txt")  # fmt: skip
    for file in files:
        add(f"kitti_raw/{file.name}", file, lambda: use_whole(open_drive(raw)))
    calibration = raw.parent / "calib_cam_to_cam.txt"
    numbers = {"S": "64 48", "K": "80 0 32 0 80 24 0 0 1", "D": "0 0 0 0 0",
               "R": "1 0 0 0 1 0 0 0 1", "T": "0 0 0"}  # fmt: skip
    path = folder / "calib_cam_to_cam.txt"
    path.write_text(
        calibration.read_text()
        + "".join(
            f"{key}_{n:02d}: {value}\n" for n in (0, 1) for key, value in numbers.items()
        ).replace("T_01: 0 0 0", "T_01: -0.5 0 0")
    )
    add("calibration", path, lambda: read_kitti_calibration(path))


def add_logs(folder: Path, add: Add) -> None:
    log = folder / "log.csv"
    log.write_text("stamp_s,vx_mps,yaw_rate_radps,other\n0.0,1.5,0.1,a\n0.1,1.6,,b\n0.2,1.7,0,c\n")
    add("log.csv", log, lambda: read_signal_log(log))
    parquet = folder / "log.parquet"
    pd.DataFrame({"stamp_s": [0.0, 0.1, 0.2], "vx_mps": [1.0, 2.0, 3.0]}).to_parquet(parquet)
    add("log.parquet", parquet, lambda: read_signal_log(parquet))


def add_logger(folder: Path, add: Add) -> None:
    """What `polemap convert` reads: a logger's CSV with its mapping, NMEA, GPX."""
    can, names = folder / "can.csv", folder / "names.yaml"
    can.write_text(
        "Time [ms];v [km/h];gz;note\n0;36,0;1,5;a\n20;36,5;1,4;b\n40;37,0;1,3;c\n60;37,5;1,2;d\n"
    )
    names.write_text(
        "drive: {vehicle: {wheelbase_m: 2.7}, frame: {kind: local, name: x}}\nodometry:\n"
        "  stamp_s: {column: 'Time [ms]', unit: ms}\n"
        "  speed_mps: {column: 'v [km/h]', unit: km/h}\n"
        "  yaw_rate_radps: {column: gz, unit: deg/s, turn: clockwise}\n"
    )

    def convert() -> None:
        convert_logs([can], read_log_mapping(names, ()), name="x")

    add("logger/can.csv", can, convert)
    add("logger/names.yaml", names, convert)
    nmea, gpx = folder / "gps.nmea", folder / "track.gpx"
    sentences = (
        "GPRMC,120000.00,A,4807.0380,N,01131.0000,E,022.4,084.4,010524,,,A",
        "GPGGA,120000.00,4807.0380,N,01131.0000,E,1,08,0.9,545.4,M,46.9,M,,",
        "GPGGA,120001.00,4807.0390,N,01131.0010,E,1,08,0.9,545.4,M,46.9,M,,",
    )
    sums = (reduce(xor, sentence.encode()) for sentence in sentences)
    nmea.write_text("".join(f"${s}*{n:02X}\n" for s, n in zip(sentences, sums, strict=True)))
    gpx.write_text(
        '<?xml version="1.0"?>\n<gpx version="1.1"><trk><trkseg>\n'
        '<trkpt lat="48.1" lon="11.5"><time>2024-05-01T12:00:00Z</time><hdop>1.1</hdop></trkpt>\n'
        '<trkpt lat="48.1001" lon="11.5"><time>2024-05-01T12:00:01Z</time></trkpt>\n'
        "</trkseg></trk></gpx>\n"
    )
    for path in (nmea, gpx):
        add(f"logger/{path.name}", path, partial(_fixes, path))


def _fixes(path: Path) -> None:
    convert_logs([path], LogMapping("x"), name="x", wheelbase_m=2.7)


def add_calibrations(folder: Path, add: Add) -> None:
    """Calibration files of pairs that are not rectified, in each form."""
    pair = make_calibration()
    files = {
        "opencv.yaml": write_opencv(folder / "opencv.yaml", opencv_values(pair)),
        "kalibr.yaml": write_kalibr(folder / "kalibr.yaml", pair),
        "calib_cam_to_cam.txt": write_kitti(folder / "calib_cam_to_cam.txt", pair),
    }
    for name, path in files.items():
        add(f"calibration/{name}", path, partial(read_calibration, path))
