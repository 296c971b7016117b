"""docs/recordings.md names every key of a mapping and every unit; its example is a mapping."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel

from polemap.drivelog.problems import inner_models
from polemap.drivelog.readers.bags.mapping import SPEED_UNITS, TURN_UNITS, Mapping
from polemap.drivelog.readers.bags.mapping_file import read_mapping

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "recordings.md").read_text(encoding="utf-8")


def keys(model: type[BaseModel]) -> Iterator[str]:
    for name, field in model.model_fields.items():
        yield name
        for inner in inner_models(field.annotation):
            yield from keys(inner)


def test_every_key_and_unit_is_there() -> None:
    for name in {*keys(Mapping), *SPEED_UNITS, *TURN_UNITS}:
        assert re.search(rf"(?<!\w){re.escape(name)}(?!\w)", PAGE), name


def test_the_example_is_a_mapping(tmp_path: Path) -> None:
    example = re.search(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    assert example is not None
    (tmp_path / "topics.yaml").write_text(example[1], encoding="utf-8")
    mapping = read_mapping(tmp_path / "topics.yaml")
    assert mapping.camera is not None
    assert mapping.reference is not None
    assert mapping.fields() == {"/joint_states": ("velocity[2]", "velocity[3]")}
