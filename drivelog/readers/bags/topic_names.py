"""What the streams of a recording are called: by their topics, and by the mapping of these."""

from __future__ import annotations

from polemap.drivelog.readers.bags.guess import pole_topic, used_topics
from polemap.drivelog.readers.bags.index import LogIndex
from polemap.drivelog.readers.bags.mapping import Mapping
from polemap.drivelog.source_names import SourceNames

_HEAD = "a mapping (--topics)"


def topic_names(index: LogIndex, mapping: Mapping) -> SourceNames:
    """The topics of each stream; where there is none, what a topic would have to hold."""
    uses = used_topics(mapping)

    def of(absent: str, *roles: str) -> str:
        topics = [t for t, use in uses.items() if any(role in use.split(", ") for role in roles)]
        return ", ".join(topics) or f"a topic of {absent} (--topics)"

    return SourceNames.distinct(
        frames=of("stereo pictures", "left pictures", "right pictures"),
        odometry=of("speed and yaw rate", "speed", "yaw rate"),
        gnss=of("GNSS fixes", "GNSS"),
        reference=of("reference poses", "reference"),
        poles=pole_topic(index) or "a topic of detected poles",
        laps=f"laps of {_HEAD}",
        head=_HEAD,
    )
