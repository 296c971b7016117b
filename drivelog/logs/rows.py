"""Rows of a stream from logs, and what became of those that were left out."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.logs.table import Values

Floats = NDArray[np.float64]


@dataclass(slots=True)
class Rows:
    """Rows of a stream, and what became of the rest.

    Attributes:
        columns: by our names, `(n,)` each; `stamp_s` among them.
        rows_read: in the logs.
        dropped: rows left out, by reason.
        notes: what a reader of the result must know.
    """

    columns: dict[str, Values]
    rows_read: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)

    def numbers(self, name: str) -> Floats:
        """A column of numbers."""
        return np.asarray(self.columns[name], dtype=np.float64)

    def keep(self, rows: NDArray[np.bool_], reason: str) -> None:
        """Leave the other rows out, counted under a reason."""
        lost = int(np.count_nonzero(~rows))
        if lost:
            self.dropped[reason] += lost
            self.columns = {name: values[rows] for name, values in self.columns.items()}
