"""Checksums of an index's bytes, held against them where they are first touched.

The bytes of all arrays are one row of blocks, each with its CRC-32. Opening an index reads none of
them; a query checks the blocks that it touches, once.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import InputError
from polemap.map.pattern_index.cells import members

Whole = NDArray[np.int64]

BLOCK = 2**16
"""Bytes: as many as Linux maps around a page that is touched."""
_BITS = 16


class BlockSums:
    """CRC-32 of the blocks of bytes that are added one behind the other."""

    def __init__(self) -> None:
        self._sums: list[int] = []
        self._open, self._filled = 0, 0

    def add(self, data: bytes | memoryview) -> None:
        """Take in the next bytes."""
        view = memoryview(data).cast("B")
        at = 0
        while at < len(view):
            part = view[at : at + BLOCK - self._filled]
            self._open = zlib.crc32(part, self._open)
            self._filled += len(part)
            at += len(part)
            if self._filled == BLOCK:
                self._sums.append(self._open)
                self._open, self._filled = 0, 0

    def sums(self) -> NDArray[np.uint32]:
        """Of all blocks, the last of which may be shorter."""
        return np.array(self._sums + ([self._open] if self._filled else []), dtype="<u4")


class CheckedBlocks:
    """The blocks of an opened index, and which of them are known to be as they were written.

    Args:
        name: of the file, and what remedies damage: for messages.
        data: `(b,)` bytes of all arrays.
        sums: CRC-32 of their blocks.
        places: where each array begins in them, and how many bytes a row of it takes.
        changed: says whether the file is another one than when it was opened.
    """

    def __init__(
        self,
        name: tuple[str, str],
        data: NDArray[np.uint8],
        sums: NDArray[np.uint32],
        places: Mapping[str, tuple[int, int]],
        changed: Callable[[], bool],
    ) -> None:
        self._file, self._remedy = name
        self._data, self._sums, self._places, self._changed = data, sums, places, changed
        self._good = np.zeros(len(sums), dtype=bool)
        self._lock = Lock()

    def check(self, array: str, rows: Whole) -> None:
        """Hold the blocks of rows against their checksums.

        Raises:
            InputError: they are damaged, or the file was written over.
        """
        offset, size = self._places[array]
        self._check_blocks((offset + rows * size) >> _BITS)

    def check_ranges(self, array: str, first: Whole, stop: Whole) -> None:
        """The same for all rows from `first` to before `stop`.

        Raises:
            InputError: they are damaged, or the file was written over.
        """
        offset, size = self._places[array]
        filled = stop > first
        begin = (offset + first[filled] * size) >> _BITS
        end = (offset + stop[filled] * size - 1) >> _BITS
        self._check_blocks(members(begin, end + 1)[0])

    def check_all(self) -> None:
        """The same for everything.

        Raises:
            InputError: something is damaged, or the file was written over.
        """
        self._check_blocks(np.arange(len(self._sums)))

    def damaged(self, what: str) -> InputError:
        """What is raised where the bytes of an array are not what was written."""
        return InputError(f"{self._file}: its {what} is damaged; {self._remedy}")

    def check_unchanged(self) -> None:
        """To be asked before any byte is touched: what was cut off is not there to be read.

        Raises:
            InputError: the file was written over.
        """
        if self._changed():
            raise InputError(
                f"{self._file}: it was written over while it was in use; begin again, and replace "
                "it by a rename only"
            )

    def _check_blocks(self, blocks: Whole) -> None:
        self.check_unchanged()
        if self._good[blocks].all():
            return
        for block in np.unique(blocks[~self._good[blocks]]).tolist():
            part: Any = self._data[block * BLOCK : (block + 1) * BLOCK]
            if zlib.crc32(part) != self._sums[block]:
                raise self.damaged(f"block {block} of {len(self._sums)}")
            with self._lock:
                self._good[block] = True
