"""What each topic is for, guessed by type and name; of two that are as likely, neither."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from polemap.drivelog.readers.bags import mapping as m
from polemap.drivelog.readers.bags.index import LogIndex, Topic
from polemap.drivelog.readers.bags.stereo_pair import guess_pair

_COMMAND = re.compile(r"cmd|command|desired|target|setpoint|goal|plan|initialpose|waypoint")
_TRUTH = re.compile(r"truth|(?:^|[/_])(?:gt|ref|reference)(?:[/_]|$)")
_FUSED = re.compile(
    r"ekf|ukf|filtered|fused|global|gps|gnss|rtk|(?:^|[/_])ins(?:[/_]|$)|oxts|novatel|slam|"
    r"localization|map"
)
_DRIFTING = re.compile(r"visual|vio|(?:^|[/_])vo(?:[/_]|$)|icp|lio|kiss|lidar|laser")
_WHEELS = re.compile(r"wheel|encoder|(?:^|[/_])can(?:[/_]|$)|vehicle|chassis|odom")
_FIX = re.compile(r"gnss|gps|(?:^|[/_])fix(?:[/_]|$)")
# foxglove.CompressedVideo, ffmpeg_image_transport_msgs, theora_image_transport
_VIDEO = re.compile(r"video|ffmpeg|theora")
_EARTH_FRAMES = ("map", "world", "utm", "earth", "enu", "global")
# a pose topic without any hint is taken for a reference only in a frame that does not drift
_REFERENCE_MIN = 3


@dataclass(slots=True)
class Guess:
    """A mapping, and for every topic what it is used for or why it is not.

    Attributes:
        ambiguous: roles that two topics could play, with their names.
    """

    mapping: m.Mapping
    uses: dict[str, str] = field(default_factory=dict)
    ambiguous: dict[str, tuple[str, ...]] = field(default_factory=dict)


def guess(index: LogIndex, given: m.Mapping | None = None) -> Guess:
    """The mapping of a recording; what `given` says stands.

    Args:
        index: the recording after its one pass.
        given: parts that it states are taken as they are, those it states as null left out.
    """
    given = given or m.Mapping()
    told = given.model_fields_set
    made = Guess(given)
    topics = index.topics
    parts: dict[str, object] = {}
    if "camera" not in told:
        pair = guess_pair(index, made.uses)
        if isinstance(pair, tuple):
            made.ambiguous["camera"] = pair
        else:
            parts["camera"] = pair
    if "odometry" not in told:
        parts["odometry"] = _odometry(
            topics, _pick("odometry", topics, _odometry_score, made), made
        )
    if "gnss" not in told:
        fixes = _pick("gnss", topics, _gnss_score, made)
        parts["gnss"] = m.GnssPart(topic=fixes) if fixes else None
    if "reference" not in told:
        # an INS gives both: its speed is odometry, its pose a reference
        poses = _pick("reference", topics, _reference_score, made)
        parts["reference"] = m.ReferencePart(topic=poses) if poses else None
    found = {name: part for name, part in parts.items() if part is not None}
    made.mapping = given.model_copy(update=found)
    _explain(index, made)
    return made


def _pick(
    role: str, topics: Mapping[str, Topic], score: Callable[[Topic], int], made: Guess
) -> str | None:
    """The one topic with the highest positive score; None, said in `ambiguous`, for several."""
    scores = {
        name: value
        for name, topic in topics.items()
        if topic.count > topic.undecodable and (value := score(topic)) > 0
    }
    if not scores:
        return None
    best = max(scores.values())
    names = tuple(name for name, value in scores.items() if value == best)
    if len(names) > 1:
        made.ambiguous[role] = names
        return None
    return names[0]


def _name(topic: Topic) -> str:
    return topic.name.lower()


def _odometry_score(topic: Topic) -> int:
    name = _name(topic)
    if topic.kind not in ("odometry", "twist", "ackermann"):
        return 0
    if _COMMAND.search(name) or _TRUTH.search(name):
        return 0
    if topic.columns[0] == "x_m" and stands_still(topic) and moves(topic):
        return 0  # a pose without a speed: many that estimate poses leave the twist at zero
    score = {"odometry": 6, "twist": 6, "ackermann": 5}[topic.kind]
    score += 3 * bool(_WHEELS.search(name))
    return score - 4 * bool(_FUSED.search(name) or _DRIFTING.search(name))


def stands_still(topic: Topic) -> bool:
    """Whether a topic never states a speed."""
    return not np.any(topic.column("speed_mps"))


def moves(topic: Topic) -> bool:
    """Whether the poses of a topic are not all the same."""
    return bool(np.ptp(topic.column("x_m")) + np.ptp(topic.column("y_m")) > 0.5)


def _odometry(topics: Mapping[str, Topic], speed: str | None, made: Guess) -> m.OdometryPart | None:
    if speed is None:
        return None
    yaw_rate = None
    topic = topics[speed]
    without = topic.kind == "ackermann" or not np.any(topic.column("yaw_rate_radps"))
    if without:
        imu = _pick("yaw rate", topics, _imu_score, made)
        yaw_rate = m.Signal(topic=imu) if imu else None
    return m.OdometryPart(speed=m.Signal(topic=speed), yaw_rate=yaw_rate)


def _imu_score(topic: Topic) -> int:
    if topic.kind != "imu" or not np.any(topic.column("z_radps")):
        return 0
    return 2 + ("imu" in _name(topic)) - bool(re.search("raw|camera|lidar", _name(topic)))


def _is_local_fix(topic: Topic) -> bool:
    """Whether a pose is a receiver's in a local frame: by its name, and it never turns."""
    if topic.kind != "pose" or not _FIX.search(_name(topic)):
        return False
    return all(np.ptp(topic.column(name)) == 0.0 for name in ("qx", "qy", "qz", "qw"))


def _gnss_score(topic: Topic) -> int:
    if _is_local_fix(topic):
        return 1
    if topic.kind != "gnss" or not np.any(topic.column("status") >= 0):
        return 0
    name = _name(topic)
    return 4 - bool(re.search("filtered|fused|ekf|rtk", name)) - 2 * bool(_TRUTH.search(name))


def _reference_score(topic: Topic) -> int:
    name = _name(topic)
    if topic.kind not in ("pose", "odometry") or _COMMAND.search(name) or _is_local_fix(topic):
        return 0
    earth = topic.frame_id.lower().split("/")[-1] in _EARTH_FRAMES
    score = 2 if topic.kind == "pose" else 0
    score += 5 * bool(_TRUTH.search(name)) + 2 * bool(_FUSED.search(name)) + earth
    score -= 3 * bool(_DRIFTING.search(name)) + 3 * (topic.frame_id.lower() == "odom")
    return score if score >= _REFERENCE_MIN else 0


def used_topics(mapping: m.Mapping) -> dict[str, str]:
    """What each topic of a mapping is used for."""
    uses: dict[str, str] = {}

    def add(topic: str | None, what: str) -> None:
        if topic is not None:
            uses[topic] = f"{uses[topic]}, {what}" if topic in uses else what

    if mapping.camera is not None:
        for side in ("left", "right"):
            camera = getattr(mapping.camera, side)
            add(camera.image, f"{side} pictures")
            add(camera.info, f"{side} calibration")
    if mapping.odometry is not None:
        add(mapping.odometry.speed.topic, "speed")
        right, turn = mapping.odometry.right_wheel, mapping.odometry.yaw_rate
        add(right.topic if right else None, "speed")
        if turn is not None or mapping.odometry.track_m is None:
            add((turn or mapping.odometry.speed).topic, "yaw rate")
    add(mapping.gnss.topic if mapping.gnss else None, "GNSS")
    add(mapping.reference.topic if mapping.reference else None, "reference")
    return uses


def pole_topic(index: LogIndex) -> str | None:
    """The first topic of poles that were detected elsewhere."""
    return next((name for name, topic in index.topics.items() if topic.kind == "poles"), None)


def _explain(index: LogIndex, made: Guess) -> None:
    """Fill `uses` for every topic: its use, or why it has none."""
    used = used_topics(made.mapping)
    poles = pole_topic(index)
    doubtful = {name: role for role, names in made.ambiguous.items() for name in names}
    for name, topic in index.topics.items():
        if name in used:
            made.uses[name] = used[name]
        elif name in doubtful:
            made.uses[name] = f"not used: one of several that could be {doubtful[name]}"
        elif topic.kind == "transforms":
            made.uses[name] = "mountings"
        elif name == poles:
            made.uses[name] = "poles detected elsewhere"
        elif name not in made.uses:
            made.uses[name] = f"not used: {_why_not(topic, used)}"


def is_video(topic: Topic) -> bool:
    """Whether a topic holds frames that only their predecessors explain."""
    return topic.kind is None and bool(_VIDEO.search(topic.channel.type_name.lower()))


def _why_not(topic: Topic, used: Mapping[str, str]) -> str:
    name = _name(topic)
    if not topic.count:
        return "holds no message"
    if topic.undecodable == topic.count or (topic.reason and not topic.undecodable):
        return topic.reason[:100]
    if topic.kind == "picture" and "left pictures" not in used.values():
        return "no pair: one of two cameras is told by left and right, 0 and 1, or by calibration"
    if topic.kind == "camera" and "left pictures" not in used.values():
        return "its pictures are not used"
    if topic.kind == "poles":
        return "another topic of poles was recorded first"
    if is_video(topic):
        return "a video: only single pictures (raw, JPEG, PNG) can be read"
    if topic.kind is None:
        return "nothing here reads this type"
    if topic.kind in ("pose", "odometry", "twist", "ackermann") and _COMMAND.search(name):
        return "by its name a command or a plan"
    if topic.kind == "joints":
        return "wheel speeds need wheel_radius_m, by a mapping"
    if topic.kind == "number":
        return "a number whose meaning and unit a mapping has to tell (odometry)"
    if topic.kind == "imu":
        return "the yaw rate comes from elsewhere"
    if topic.kind == "odometry" and topic.frame_id.lower() == "odom":
        return "another topic gives the speed, and poses in 'odom' drift"
    if topic.kind in ("pose", "odometry") and not any(_TRUTH.search(n.lower()) for n in used):
        return "neither by name nor by frame a reference"
    return "another topic is the better one"
