"""Column tables: frozen dataclasses of arrays that share their rows.

Every table of the project (streams of a drive, detections, hypotheses, tracks, landmarks of a map)
takes rows, joins parts and goes to files by the functions here, which know nothing of its fields.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError

_NAMES: dict[type[Any], tuple[str, ...]] = {}  # a table is made for every frame several times
Rows = slice | NDArray[np.bool_] | NDArray[np.int64]


class Columns:
    """Base of tables; every field that `HEADER` does not name is an array with a row an entry.

    The arrays are read-only views of what the table was made from.

    Raises:
        InputError: columns of unequal length.
    """

    __slots__ = ()
    HEADER: ClassVar[frozenset[str]] = frozenset()
    """Fields that belong to the table as a whole: a stamp, a name, a table of another length."""

    def __post_init__(self) -> None:
        first, *others = column_names(type(self))
        rows = len(getattr(self, first))
        for name in (first, *others):
            values = np.asarray(getattr(self, name))
            if len(values) != rows:
                raise InputError(
                    f"{type(self).__name__}: column {name} has {len(values)} rows, {first} {rows}"
                )
            column = values.view()
            column.setflags(write=False)
            object.__setattr__(self, name, column)

    def __len__(self) -> int:
        return len(getattr(self, column_names(type(self))[0]))

    def take(self, rows: Rows) -> Self:
        """The chosen rows, under the same header."""
        return replace(self, **{name: values[rows] for name, values in self.arrays().items()})  # type: ignore[type-var]

    def with_columns(self, **columns: NDArray[Any]) -> Self:
        """The table with some columns in the place of its own."""
        return replace(self, **columns)  # type: ignore[type-var]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The columns by name."""
        return {name: getattr(self, name) for name in column_names(type(self))}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], **header: Any) -> Self:
        """The table of `arrays()` and its header; further arrays are left alone.

        Raises:
            KeyError: a column is missing.
        """
        return cls(**{name: arrays[name] for name in column_names(cls)}, **header)

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """The rows of all parts, one after the other, under the header of the first one."""
        header = {name: getattr(parts[0], name) for name in cls.HEADER}
        columns = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in column_names(cls)
        }
        return cls(**header, **columns)


def column_names(table: type[Any]) -> tuple[str, ...]:
    """Names of a table's columns, in the order of its fields."""
    if table not in _NAMES:
        _NAMES[table] = tuple(f.name for f in fields(table) if f.name not in table.HEADER)
    return _NAMES[table]
