"""A drive from the index of a recording and the mapping of its topics."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections, VisibleRegion
from polemap.drivelog.drive import Drive, Lap
from polemap.drivelog.errors import InputError
from polemap.drivelog.findings import Finding
from polemap.drivelog.frames import EarthFrame, grid_from_geographic, utm_frame
from polemap.drivelog.images import RectifiedPairs
from polemap.drivelog.readers.bags.camera import stereo_camera
from polemap.drivelog.readers.bags.clocks import compare_clocks, seconds
from polemap.drivelog.readers.bags.frames import log_pictures, pair_pictures
from polemap.drivelog.readers.bags.guess import Guess, is_video, pole_topic, used_topics
from polemap.drivelog.readers.bags.index import LogIndex
from polemap.drivelog.readers.bags.odometry_signals import odometry_stream
from polemap.drivelog.readers.bags.signals import Signals, gnss_stream, pole_scans, reference_stream
from polemap.drivelog.readers.bags.topic_names import topic_names
from polemap.drivelog.readers.bags.vehicle_frame import vehicle_frame
from polemap.drivelog.streams import GnssStream, OdometryStream, ReferenceStream

Floats = NDArray[np.float64]
Stream = TypeVar("Stream", OdometryStream, GnssStream, ReferenceStream)

# of a middle car, where nothing says it
_WHEELBASE_M = 2.7
# poses farther from the fixes than this are not in the grid that the fixes are in
_SAME_GRID_M = 1000.0


class Build:
    """A drive from an index and a mapping."""

    def __init__(
        self, path: Path, index: LogIndex, made: Guess, view: VisibleRegion | None = None
    ) -> None:
        """`view` is that of the detector of poles on a topic, where it is known."""
        self._path, self._index, self._made, self._view = path, index, made, view
        self._mapping = made.mapping
        self._problems: Counter[str] = Counter()
        self._notes: list[str] = []
        self._findings: list[Finding] = []
        used = [index.topics[name] for name in used_topics(self._mapping)]
        self._clock = compare_clocks([topic for topic in used if topic.kind != "camera"])
        children = {topic.child_frame_id for topic in used if topic.child_frame_id}
        self._vehicle = vehicle_frame(index.transforms, self._mapping.vehicle, children)

    def drive(self) -> Drive:
        """The drive."""
        mapping, signals = self._mapping, self._signals()
        frame = self._frame()
        wheelbase_m = self._wheelbase()
        frames: dict[str, Any] = self._frames()
        reference = gnss = odometry = None
        if mapping.odometry is not None:
            odometry = self._with_rows(
                odometry_stream(signals, mapping.odometry, wheelbase_m),
                mapping.odometry.speed.topic,
            )
        if mapping.gnss is not None and self._fits(frame):
            gnss = self._with_rows(gnss_stream(signals, mapping.gnss, frame), mapping.gnss.topic)
        if mapping.reference is not None:
            reference = self._with_rows(
                reference_stream(signals, mapping.reference), mapping.reference.topic
            )
        self._tell()
        return Drive(
            name=self._path.stem,
            path=self._path,
            frame=frame,
            wheelbase_m=wheelbase_m,
            gnss_antenna_m=self._antenna(gnss is not None),
            odometry=odometry,
            gnss=gnss,
            reference=reference,
            scans=self._scans(signals),
            laps=tuple(Lap(lap.name, lap.start_s, lap.end_s) for lap in mapping.laps),
            notes=tuple(dict.fromkeys(self._notes)),
            problems={name: count for name, count in self._problems.items() if count},
            findings=tuple(self._findings),
            names=topic_names(self._index, mapping),
            **frames,
        )

    def _with_rows(self, stream: Stream, topic: str) -> Stream | None:
        """The stream; None, with a finding, where no message of its topic could be used."""
        if len(stream):
            return stream
        count = self._index.topics[topic].count
        self._findings.append(
            Finding(
                "rows_left_out", "error", topic, f"none of its {count} messages can be used",
                "finite numbers in range", "see what was left out; choose another topic in a "
                "mapping, or null",
            )
        )  # fmt: skip
        return None

    def _signals(self) -> Signals:
        return Signals(self._index, self._vehicle, self._clock, self._problems, self._notes)

    def _scans(self, signals: Signals) -> tuple[Detections, ...]:
        name = pole_topic(self._index)
        if name is None or not self._index.topics[name].count:
            return ()
        return pole_scans(signals, self._index.topics[name], self._view)

    def _wheelbase(self) -> float:
        told = self._mapping.vehicle.wheelbase_m
        if told is None:
            self._notes.append(
                f"the wheelbase is taken to be {_WHEELBASE_M} m; set vehicle.wheelbase_m in a "
                "mapping"
            )
        return _WHEELBASE_M if told is None else told

    def _frames(self) -> dict[str, Any]:
        part = self._mapping.camera
        if part is None:
            return {}
        index = self._index
        left, right = (index.topics[side.image] for side in (part.left, part.right))
        try:
            rig, rectifier = stereo_camera(index, part, self._vehicle, self._findings)
        except InputError as error:
            self._findings.append(
                Finding(
                    "camera_calibration", "error", part.left.image, str(error),
                    "a calibrated, rectified pair", "the pictures are left out until then",
                )
            )  # fmt: skip
            return {}
        pairs, tolerance_s = pair_pictures(left, right, part.pair_tolerance_s, self._signals())
        unpaired = self._problems["left_pictures_without_partner"]
        if unpaired:
            self._notes.append(
                f"{unpaired} of {left.count} left pictures have no right one within "
                f"{1000 * tolerance_s:.1f} ms; camera.pair_tolerance_s of a mapping changes that"
            )
        stamps = seconds(pairs.stamp_ns), seconds(pairs.arrival_ns)
        size = rectifier.raw_size_px if rectifier else (rig.width_px, rig.height_px)
        images = log_pictures(index, left, right, pairs, size)
        return {
            "rig": rig,
            "frame_stamps_s": stamps[0],
            "frame_arrivals_s": stamps[1] if self._clock.usable else stamps[0],
            "frame_numbers": pairs.rows[:, 0],
            "images": RectifiedPairs(images, rectifier) if rectifier else images,
        }

    def _frame(self) -> EarthFrame:
        """The earth frame: as told, or that of the reference, or the zone of the first fix."""
        told = self._mapping.frame
        if told is not None:
            return EarthFrame(told.kind, told.epsg, told.name)
        zone, fix = self._zone()
        part = self._mapping.reference
        if part is None or (part.origin is not None and zone is not None):
            return zone or EarthFrame("local", name=self._path.stem)
        topic = self._index.topics[part.topic]
        points = np.stack([topic.column("x_m"), topic.column("y_m")], axis=1)
        points = points[np.isfinite(points).all(axis=1)]
        if zone is not None and fix is not None and len(points):
            apart = np.median(points, axis=0) - fix
            if np.hypot(apart[0], apart[1]) < _SAME_GRID_M:
                return zone
        return EarthFrame("local", name=topic.frame_id or self._path.stem)

    def _zone(self) -> tuple[EarthFrame | None, Floats | None]:
        """UTM zone of the first fix, and the middle of all fixes in it."""
        part = self._mapping.gnss
        topic = self._index.topics[part.topic] if part is not None else None
        if topic is None or topic.kind != "gnss":
            return None, None
        place = np.stack([topic.column("latitude_deg"), topic.column("longitude_deg")], axis=1)
        good = np.isfinite(place).all(axis=1) & (topic.column("status") >= 0)
        good &= (np.abs(place[:, 0]) <= 84) & (np.abs(place[:, 1]) <= 180)
        if not np.any(good):
            return None, None
        zone = utm_frame(*(float(value) for value in place[good][0]))
        return zone, np.median(grid_from_geographic(zone, *place[good].T), axis=0)

    def _fits(self, frame: EarthFrame) -> bool:
        """Whether the fixes can be put into the drive's frame; said where they cannot."""
        part = self._mapping.gnss
        if part is None or frame.is_utm or self._index.topics[part.topic].kind != "gnss":
            return True
        whose, remedy = "", "look whether they are degrees of WGS84"
        if self._mapping.frame is not None:
            remedy = "set a frame of kind utm in the mapping"
        elif self._mapping.reference is not None:
            whose = " of the reference poses"
            remedy = ("set reference.origin (where its frame stands in the UTM zone) in a mapping, "
                      "or reference: null")  # fmt: skip
        self._findings.append(
            Finding(
                "gnss_frame", "warning", part.topic,
                f"latitudes and longitudes cannot be put into {frame}{whose}",
                "fixes in a UTM zone, and the reference in the same",
                f"the fixes are left out; {remedy}",
            )
        )  # fmt: skip
        return False

    def _antenna(self, used: bool) -> Floats:
        part = self._mapping.gnss
        if part is None or not used:
            return np.zeros(2)
        if part.antenna is not None:
            return np.array([part.antenna.x_m, part.antenna.y_m])
        topic = self._index.topics[part.topic]
        if topic.kind != "gnss":  # its frame is that of the positions, not the antenna
            self._notes.append(
                f"{part.topic}: the antenna is taken to be at the rear axle; gnss.antenna of a "
                "mapping moves it"
            )
            return np.zeros(2)
        frame = topic.frame_id
        way = self._vehicle.vehicle_from(frame)
        if way is None:
            self._notes.append(
                f"{part.topic}: no TF leads to '{frame}': the antenna is taken to be at the rear "
                "axle; gnss.antenna of a mapping moves it"
            )
            return np.zeros(2)
        return np.asarray(way[:2, 3])

    def _tell(self) -> None:
        """Notes and findings on the recording as a whole."""
        if self._clock.note:
            self._notes.append(self._clock.note)
        self._notes += self._vehicle.notes
        for name, topic in self._index.topics.items():
            if topic.undecodable:
                self._problems[f"{name} undecodable"] += topic.undecodable
            if topic.differs and name in used_topics(self._mapping):
                self._findings.append(
                    Finding(
                        "calibration_changes", "warning", name,
                        f"{topic.differs} of {topic.count} calibrations differ from the first",
                        "one calibration", "the first is taken; cut the recording where it changes",
                    )
                )  # fmt: skip
        for damage in self._index.damage:
            self._findings.append(
                Finding(
                    "log_damaged", "warning", self._path.name, damage, "a whole recording",
                    "restore it, or mend it: `rosbag reindex`, `ros2 bag reindex`, `mcap recover`",
                )
            )  # fmt: skip
        if not any(topic.count for topic in self._index.topics.values()):
            self._findings.append(
                Finding(
                    "log_empty", "error", self._path.name, "no message", "a recording of a drive",
                    "look whether the recorder was subscribed to the topics",
                )
            )  # fmt: skip
        videos = [name for name, topic in self._index.topics.items() if is_video(topic)]
        if videos and self._mapping.camera is None:
            self._findings.append(
                Finding(
                    "video_not_read", "warning", videos[0],
                    f"video of type {self._index.topics[videos[0]].channel.type_name}",
                    "single pictures, raw or as JPEG or PNG",
                    "record the camera's image topics, or republish the video as them: "
                    "`ros2 run image_transport republish`",
                )
            )  # fmt: skip
        for role, names in self._made.ambiguous.items():
            self._findings.append(
                Finding(
                    "topic_ambiguous", "warning", role, f"{' and '.join(names)} are as likely",
                    "one topic", "choose in a mapping (info --write-mapping, --topics)",
                )
            )  # fmt: skip
