"""What the streams of a recording are called: by their topics, and by the mapping of these."""

from __future__ import annotations

from dataclasses import replace

from polemap.drivelog.readers.bags.guess import pole_topic, used_topics
from polemap.drivelog.readers.bags.index import LogIndex
from polemap.drivelog.readers.bags.mapping import Mapping
from polemap.drivelog.source_names import CalibrationNames, SourceNames

_HEAD = "a mapping (--topics)"


def topic_names(index: LogIndex, mapping: Mapping) -> SourceNames:
    """The topics of each stream; where there is none, what a topic would have to hold."""
    uses = used_topics(mapping)

    def of(absent: str, *roles: str) -> str:
        topics = [t for t, use in uses.items() if any(role in use.split(", ") for role in roles)]
        return ", ".join(topics) or f"a topic of {absent} (--topics)"

    names = SourceNames.distinct(
        frames=of("stereo pictures", "left pictures", "right pictures"),
        odometry=of("speed and yaw rate", "speed", "yaw rate"),
        gnss=of("GNSS fixes", "GNSS"),
        reference=of("reference poses", "reference"),
        poles=pole_topic(index) or "a topic of detected poles",
        laps=f"laps of {_HEAD}",
        head=_HEAD,
    )
    return replace(names, calibration=_calibration_names(mapping))


def _calibration_names(mapping: Mapping) -> CalibrationNames:
    """Fields of the camera's topics and of TF, or the keys of the mapping that stand for them."""
    wheelbase = f"vehicle.wheelbase_m of {_HEAD}"
    part = mapping.camera
    if part is None:
        return CalibrationNames(wheelbase)
    place = "the camera's {} in TF"
    if part.vehicle_from_camera is not None:
        place = f"camera.vehicle_from_camera.{{}} of {_HEAD}"
    keys = "z_m", "pitch_rad", "yaw_rad"
    words = keys if part.vehicle_from_camera is not None else ("height", "pitch", "yaw")
    baseline = f"P[0,3] of {part.right.info}, or the cameras' distance in TF"
    if part.baseline_m is not None:
        baseline = f"camera.baseline_m of {_HEAD}"
    return CalibrationNames(
        wheelbase,
        f"P[0,0] of {part.left.info}",
        f"P[0,2] of {part.left.info}",
        f"P[1,2] of {part.left.info}",
        baseline,
        *(place.format(word) for word in words),
    )
