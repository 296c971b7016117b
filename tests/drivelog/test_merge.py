"""Streams of samples as one."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from polemap.drivelog.merge import SampleRows, merge_streams

TIMES = st.lists(st.integers(0, 5), max_size=8)


def _rows(name: str, times: list[int]) -> SampleRows[tuple[str, int]]:
    stamps = np.array(times, dtype=float)
    return SampleRows(stamps + stamps % 2, stamps, lambda row: (name, row))


@given(st.lists(TIMES, max_size=4))
def test_by_arrival_then_stamp_then_stream_then_row(times: list[list[int]]) -> None:
    streams = [_rows(str(number), rows) for number, rows in enumerate(times)]
    expected = sorted(
        (time + time % 2, time, number, row)
        for number, rows in enumerate(times)
        for row, time in enumerate(rows)
    )
    assert list(merge_streams(streams)) == [(str(n), row) for _, _, n, row in expected]


def test_rows_are_read_when_their_turn_comes() -> None:
    read: list[int] = []
    stamps = np.arange(3.0)
    merged = merge_streams([SampleRows(stamps, stamps, read.append)])
    assert read == []
    next(merged)
    assert read == [0]
