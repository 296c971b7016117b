"""Mapping files: read and checked, against the topics of a recording too."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import yaml
from pydantic import ValidationError

from polemap.drivelog.errors import InputError
from polemap.drivelog.problems import did_you_mean, refusal, validation_mistakes
from polemap.drivelog.readers.bags.index import LogIndex
from polemap.drivelog.readers.bags.mapping import CameraSide, Mapping, Signal
from polemap.drivelog.readers.bags.types import Kind
from polemap.parsing.errors import named
from polemap.parsing.text import MEGABYTE, read_text
from polemap.parsing.yaml_text import parse_yaml, yaml_node

_SPEEDS: tuple[Kind, ...] = ("odometry", "twist", "ackermann", "joints", "number")
_TURNS: tuple[Kind, ...] = ("odometry", "twist", "ackermann", "imu")


def read_mapping(path: Path) -> Mapping:
    """Read a mapping.

    Raises:
        InputError: no YAML, or all mistakes in it, each with its line and key.
    """
    with named(path, InputError, "mapping"):
        text = read_text(path, MEGABYTE)
        values = parse_yaml(text)
    if not isinstance(values, dict):
        raise InputError(f"{path}: holds no keys; `polemap info LOG --write-mapping` writes one")
    try:
        return Mapping.model_validate(values)
    except ValidationError as error:
        lines = key_lines(text)
        places = [tuple(str(part) for part in one["loc"]) for one in error.errors()]
        told = validation_mistakes(error, Mapping)
        raise refusal(
            path, [f"line {_line(lines, p)}: {one}" for p, one in zip(places, told, strict=True)]
        ) from error


def _line(lines: dict[tuple[str, ...], int], place: tuple[str, ...]) -> int:
    """The line of a key, or of the part that should have held it."""
    return next((lines[place[:n]] for n in range(len(place), 0, -1) if place[:n] in lines), 1)


def key_lines(text: str) -> dict[tuple[str, ...], int]:
    """The line on which each key of a YAML text stands, by its path."""

    def walk(
        node: yaml.Node | None, place: tuple[str, ...]
    ) -> Iterator[tuple[tuple[str, ...], int]]:
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                here = (*place, str(key.value))
                yield here, key.start_mark.line + 1
                yield from walk(value, here)
        elif isinstance(node, yaml.SequenceNode):
            for number, value in enumerate(node.value):
                yield (*place, str(number)), value.start_mark.line + 1
                yield from walk(value, (*place, str(number)))

    return dict(walk(yaml_node(text), ()))


def check_topics(mapping: Mapping, index: LogIndex, path: Path) -> None:
    """Every topic of a mapping is in the recording and of a type that fits.

    Raises:
        InputError: all that are not.
    """
    lines = key_lines(read_text(path, MEGABYTE))
    mistakes = []
    for place, name, kinds in _named(mapping):
        topic = index.topics.get(name)
        line = f"line {_line(lines, place)}: {'.'.join(place)}"
        if topic is None:
            hint = did_you_mean(name, list(index.topics))
            mistakes.append(f"{line}: no topic '{name[:60]}' was recorded{hint}")
        elif kinds and topic.kind not in kinds:
            mistakes.append(
                f"{line}: '{name[:60]}' is of type {topic.channel.type_name}, which gives no "
                f"{place[-2] if place[-1] == 'topic' else place[-1]}"
            )
        elif not topic.count:
            mistakes.append(f"{line}: '{name[:60]}' holds no message")
        elif topic.undecodable == topic.count or (topic.reason and not topic.undecodable):
            mistakes.append(f"{line}: '{name[:60]}' cannot be read: {topic.reason[:120]}")
    if mistakes:
        raise refusal(path, mistakes)


def _named(mapping: Mapping) -> Iterator[tuple[tuple[str, ...], str, tuple[Kind, ...]]]:
    """Place in the mapping, topic and the kinds that fit, for every topic that it names."""
    if mapping.camera is not None:
        for side in ("left", "right"):
            camera: CameraSide = getattr(mapping.camera, side)
            yield ("camera", side, "image"), camera.image, ("picture",)
            if camera.info is not None:
                yield ("camera", side, "info"), camera.info, ("camera",)
    if mapping.odometry is not None:
        roles = (("speed", _SPEEDS), ("right_wheel", _SPEEDS), ("yaw_rate", _TURNS))
        for part, kinds in roles:
            signal: Signal | None = getattr(mapping.odometry, part)
            if signal is not None:
                yield ("odometry", part, "topic"), signal.topic, () if signal.fields else kinds
    if mapping.gnss is not None:
        yield ("gnss", "topic"), mapping.gnss.topic, ("gnss", "pose", "odometry")
    if mapping.reference is not None:
        yield ("reference", "topic"), mapping.reference.topic, ("pose", "odometry")
