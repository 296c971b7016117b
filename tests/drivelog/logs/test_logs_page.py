"""docs/logs.md names every key of a mapping, every unit, and its example is a mapping."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pydantic import BaseModel

from polemap.drivelog.logs.column_parts import Stamps, Value, Where
from polemap.drivelog.logs.format_part import FormatPart
from polemap.drivelog.logs.mapping import STREAMS, read_log_mapping
from polemap.drivelog.logs.units import UNITS
from polemap.electric.io import KNOWN

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "logs.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("model", [Value, Stamps, Where, FormatPart])
def test_every_key_is_there(model: type[BaseModel]) -> None:
    for name, field in model.model_fields.items():
        assert re.search(rf"\b{field.alias or name}\b", PAGE), field.alias or name


def test_every_section_and_unit_is_there() -> None:
    for name in (*STREAMS, "signals", "drive", "formats"):
        assert f"`{name}" in PAGE or f"{name}:" in PAGE, name
    # thousandths of a unit follow from it
    for unit in {u for table in UNITS.values() for u in table}:
        assert unit in PAGE or unit[0] in "mck" or unit in ("ft/s2", "ft2", "1e-6 deg"), unit


def test_the_example_is_a_mapping(tmp_path: Path) -> None:
    example = re.search(r"```yaml\n(drive:.*?)```", PAGE, re.DOTALL)
    assert example is not None
    (tmp_path / "map.yaml").write_text(example[1], encoding="utf-8")
    mapping = read_log_mapping(tmp_path / "map.yaml", KNOWN)
    assert set(mapping.streams) == {"odometry", "gnss", "reference"}
