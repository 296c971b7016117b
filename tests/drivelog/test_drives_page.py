"""docs/drives.md names every key of drive.yaml and every column that is read."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel

from polemap.drivelog.problems import inner_models
from polemap.drivelog.readers.columns import FILES
from polemap.drivelog.readers.drive_yaml import DriveYaml

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "drives.md").read_text(encoding="utf-8")


def keys(model: type[BaseModel]) -> Iterator[str]:
    for name, field in model.model_fields.items():
        yield name
        for inner in inner_models(field.annotation):
            yield from keys(inner)


def test_every_key_of_drive_yaml_is_there_and_described() -> None:
    for name in keys(DriveYaml):
        assert re.search(rf"\b{name}\b", PAGE), name


def test_every_key_says_what_to_give() -> None:
    def undescribed(model: type[BaseModel]) -> Iterator[str]:
        for name, field in model.model_fields.items():
            if not field.description:
                yield f"{model.__name__}.{name}"
            for inner in inner_models(field.annotation):
                yield from undescribed(inner)

    assert list(undescribed(DriveYaml)) == []


def test_every_file_and_column_is_there() -> None:
    rows = {
        name: (required, optional)
        for name, required, optional in re.findall(
            r"^\| `(\w+)\.csv` \| (.*?) \|(.*?)\|$", PAGE, re.MULTILINE
        )
    }
    assert set(rows) == set(FILES)
    for name, file in FILES.items():
        required, optional = rows[name]
        for column in file.required:
            assert re.search(rf"\b{column}\b", required), (name, column)
        for column in file.optional:
            assert re.search(rf"\b{column}\b", optional), (name, column)
