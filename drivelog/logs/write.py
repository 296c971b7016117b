"""A drive folder from converted logs: drive.yaml, CSV, pictures."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from polemap.drivelog.atomic import atomic_folder
from polemap.drivelog.logs.convert import Converted
from polemap.drivelog.logs.rows import Rows

_FORMATS = {"_s": "%.6f", "_deg": "%.10f", "_m": "%.5f"}


_ROWS_AT_ONCE = 50_000


@contextmanager
def converted_folder(converted: Converted, out: Path, inputs: Sequence[Path]) -> Iterator[Path]:
    """The drive's folder, filled; it appears under its name when the block ends well.

    Raises:
        OutputError: the place cannot be written to.
    """
    with atomic_folder(out, "drive", inputs) as folder:
        text = yaml.safe_dump(_plain(converted.head), sort_keys=False, allow_unicode=True)
        (folder / "drive.yaml").write_text(text, encoding="utf-8")
        for key, rows in converted.streams.items():
            if key == "frames":
                _copy_pictures(converted, folder)
            write_rows(rows, folder / f"{key}.csv")
        yield folder


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    return [_plain(inner) for inner in value] if isinstance(value, list | tuple) else value


def _copy_pictures(converted: Converted, folder: Path) -> None:
    columns = converted.streams["frames"].columns
    for side, name in enumerate(("left", "right")):
        (folder / name).mkdir()
        paths = np.empty(len(converted.pictures), dtype=object)
        for row, pair in enumerate(converted.pictures):
            target = f"{name}/{row:06d}{pair[side].suffix.lower()}"
            shutil.copyfile(pair[side], folder / target)
            paths[row] = target
        columns[name] = paths


def write_rows(rows: Rows, path: Path) -> None:
    """A stream as CSV; what is not known is an empty cell."""
    names = ["stamp_s", *(name for name in rows.columns if name != "stamp_s")]
    form = ",".join(
        "%s" if rows.columns[name].dtype == object else _FORMATS.get(_unit(name), "%.9g")
        for name in names
    )
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(names) + "\n")
        columns = [rows.columns[name] for name in names]
        for first in range(0, len(columns[0]), _ROWS_AT_ONCE):
            block = [column[first : first + _ROWS_AT_ONCE].tolist() for column in columns]
            text = "\n".join([form % row for row in zip(*block, strict=True)])
            file.write(text.replace("nan", "") + "\n")


def _unit(name: str) -> str:
    return "_" + name.rpartition("_")[2]
