"""What is followed: which samples come, and the car that they come from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from polemap.drivelog.detections import Detections, VisibleRegion, pole_view
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import ConfigError, InputError
from polemap.drivelog.images import RectifiedPairs
from polemap.drivelog.live.growing import GrowingBytes
from polemap.drivelog.live.json_lines import BadLine, read_lines
from polemap.drivelog.live.mcap_stream import MAGIC, StreamFile, StreamMessage, read_stream
from polemap.drivelog.live.pending import PendingFrame
from polemap.drivelog.live.topics import TopicSamples
from polemap.drivelog.readers.bags.described import (
    FILES,
    FIX,
    HEAD,
    POLES,
    POSITION,
    SIDES,
    TWIST,
    describe,
    image_topic,
    own_mapping,
)
from polemap.drivelog.readers.bags.files import is_log
from polemap.drivelog.readers.bags.mapping import Mapping
from polemap.drivelog.readers.bags.mapping_file import read_mapping
from polemap.drivelog.readers.bags.reader import survey
from polemap.drivelog.readers.drive_yaml import read_drive_yaml
from polemap.drivelog.readers.poles import stated_view
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.samples import GnssFix, OdometrySample
from polemap.stereo.rectify import Rectifier

Sample = OdometrySample | GnssFix | Detections | PendingFrame


@dataclass(slots=True)
class Followed:
    """An opened stream.

    Attributes:
        car: the drive without samples: frame, wheelbase, camera, antenna.
        samples: as they come; `arrival_s` is when a recorder had them, NaN where nothing says it.
        counts: what was left out so far, by kind; `reasons` the first reason of each.
        notes: what a reader of the result must know.
    """

    car: Drive
    samples: Iterator[Sample]
    counts: Counter[str]
    reasons: dict[str, str]
    notes: tuple[str, ...] = ()


def open_followed(source: GrowingBytes, car: Path | None, topics: Path | None) -> Followed:
    """Wait for the first bytes and tell what they are.

    Args:
        car: a drive of the same car: a recording, or a folder with a drive.yaml.
        topics: mapping of a recording's topics.

    Raises:
        InputError: neither MCAP nor JSON lines, or damaged, or a car that cannot be opened.
        ConfigError: nothing tells the car, or which topics to listen to.
    """
    first = source.peek(len(MAGIC))
    if first == MAGIC:
        return _messages(source, car, topics)
    if not first.lstrip().startswith(b"{"):
        shown = first[:8].decode("ascii", "replace")
        raise InputError(
            f"{source.name}: starts with {shown!r}: neither an MCAP recording nor lines of JSON"
            if first
            else f"{source.name}: ended before its first byte"
        )
    if topics is not None:
        raise ConfigError("--topics is for recordings; lines of JSON name their types themselves")
    if car is None:
        raise ConfigError(
            "--follow of JSON lines needs --car DRIVE, a recording of the car or a folder with "
            "its drive.yaml"
        )
    opened, view = _car(car)
    counts: Counter[str] = Counter()
    reasons: dict[str, str] = {}
    return Followed(opened, _lines(source, opened, view, counts, reasons), counts, reasons)


def _lines(
    source: GrowingBytes,
    car: Drive,
    view: VisibleRegion | None,
    counts: Counter[str],
    reasons: dict[str, str],
) -> Iterator[Sample]:
    for sample in read_lines(source, car.frame, view):
        if isinstance(sample, BadLine):
            counts["lines_unusable"] += 1
            reasons.setdefault("lines_unusable", sample.reason)
        else:
            yield sample


def _messages(source: GrowingBytes, car: Path | None, topics: Path | None) -> Followed:
    stream = read_stream(source)
    files: dict[str, bytes] = {}
    begun: list[StreamMessage] = []
    for record in stream:  # attachments come before the first message, where there are any
        if isinstance(record, StreamFile):
            if record.name in FILES:
                files[record.name] = record.data
            continue
        begun.append(record)
        break
    rectifier: Rectifier | None = None
    view: VisibleRegion | None = None
    mapping = read_mapping(topics) if topics is not None else None
    if car is not None:
        opened, view = _car(car)
        if isinstance(opened.images, RectifiedPairs):
            rectifier = opened.images.rectifier
        if mapping is None and is_log(car) and HEAD not in files:
            mapping = survey(car)[1].mapping
    elif HEAD in files:
        described = describe(files, source.name)
        opened, view = described.drive, described.view
    else:
        raise ConfigError(
            f"{source.name}: does not describe its car; give --car DRIVE, a recording of the same "
            "car or a folder with its drive.yaml"
        )
    poles = None
    if mapping is None:
        known = (TWIST, FIX if opened.frame.is_utm else POSITION, *map(image_topic, SIDES))
        mapping, poles = own_mapping(known, opened), POLES
    _check(mapping, source.name)
    taken = TopicSamples(mapping, opened.frame, poles=poles, view=view, rectifier=rectifier)

    def samples() -> Iterator[Sample]:
        for message in begun:
            yield from taken.samples(message)
        for record in stream:
            if isinstance(record, StreamMessage):
                yield from taken.samples(record)

    notes = (f"listening to {', '.join(taken.topics)}",)
    return Followed(opened, samples(), taken.counts, {}, notes)


def _check(mapping: Mapping, name: str) -> None:
    if mapping.odometry is None:
        raise ConfigError(
            f"{name}: no topic is known to carry the odometry; name it in a mapping (--topics, "
            "`polemap info RECORDING --write-mapping` of an earlier recording writes one)"
        )


def _car(path: Path) -> tuple[Drive, VisibleRegion | None]:
    """A drive that stands for its car, without its samples, and what its pole detector sees."""
    drive = open_drive(path)
    view = pole_view(drive.scans)
    head = path / HEAD if path.is_dir() else None
    if view is None and head is not None and head.is_file():
        detector = read_drive_yaml(head).pole_detector
        view = stated_view(detector) if detector is not None else None
    bare = replace(drive, odometry=None, gnss=None, reference=None, scans=(), laps=(), problems={})
    return bare, view
