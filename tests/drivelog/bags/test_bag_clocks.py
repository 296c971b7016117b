"""Clocks of recordings, and pictures that belong together."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from polemap.drivelog.readers.bags.clocks import seconds
from polemap.drivelog.readers.bags.frames import nearest_once
from tests.drivelog.bags.recordings import Said
from tests.drivelog.bags.streams import (
    COUNT,
    MOUNTED,
    Opened,
    infos,
    odometry,
    pictures,
    poses,
    sides_of,
    twists,
)


@given(st.lists(st.integers(0, 2**62), min_size=1, max_size=30))
def test_seconds_are_the_doubles_that_their_decimals_are(nanoseconds: list[int]) -> None:
    found = seconds(np.array(nanoseconds, dtype=np.int64))
    wanted = [float(f"{one // 10**9}.{one % 10**9:09d}") for one in nanoseconds]
    np.testing.assert_array_equal(found, wanted)


def late(said: list[Said], by_ns: Callable[[int], int]) -> list[Said]:
    return [
        Said(one.log_ns + by_ns(row), one.topic, one.type_name, one.content)
        for row, one in enumerate(said)
    ]


def test_a_log_on_another_clock_still_tells_what_came_late(opened: Opened) -> None:
    """Written years after the headers, as a replay is; the poses 30 ms after the odometry."""
    years = 10**17
    drive = opened(late(odometry(), lambda _: years), late(poses(), lambda _: years + 30_000_000))
    assert drive.odometry is not None
    np.testing.assert_allclose(drive.odometry.arrival_s - drive.odometry.stamp_s, 0.0, atol=1e-6)
    assert any("apart from that of the headers" in note for note in drive.notes)


def test_a_log_at_another_pace_tells_no_arrivals(opened: Opened) -> None:
    drive = opened(late(odometry(), lambda row: 10**17 + row * 10**9))
    assert drive.odometry is not None
    np.testing.assert_array_equal(drive.odometry.arrival_s, drive.odometry.stamp_s)
    assert any("arrivals are not known" in note for note in drive.notes)


def test_stamps_of_zero_become_times_of_recording(opened: Opened) -> None:
    said = twists()
    for one in said[3:5]:
        one.content.header.stamp.sec = one.content.header.stamp.nanosec = 0
    drive = opened(said)
    assert drive.odometry is not None
    assert len(drive.odometry) == COUNT
    assert np.all(np.diff(drive.odometry.stamp_s) > 0)
    np.testing.assert_allclose(drive.odometry.stamp_s[3], said[3].log_ns / 1e9)
    assert any("2 of 12 messages have no stamp" in note for note in drive.notes)


def test_messages_out_of_order_and_twice_are_sorted_and_counted(opened: Opened) -> None:
    said = twists()
    said[4].content.header.stamp, said[7].content.header.stamp = (
        said[7].content.header.stamp, said[4].content.header.stamp,
    )  # fmt: skip
    said[9].content.header.stamp = said[8].content.header.stamp
    drive = opened(said)
    assert drive.odometry is not None
    assert len(drive.odometry) == COUNT - 1
    assert drive.problems["odometry_duplicate_stamps"] == 1
    assert any("out of order" in note for note in drive.notes)


def test_pictures_without_a_partner_are_counted(opened: Opened) -> None:
    left = pictures("/stereo/left/image_rect")
    right = pictures("/stereo/right/image_rect", 3_000_000)
    sides = [infos(f"/stereo/{side}/camera_info", side) for side in ("left", "right")]
    drive = opened(left, right[:4] + right[6:], *sides, MOUNTED)
    assert len(drive.frame_stamps_s) == COUNT - 2
    assert drive.problems["left_pictures_without_partner"] == 2
    assert list(drive.frame_numbers[3:6]) == [3, 6, 7]
    # the pair is there when the later of both is
    assert any("within 5.0 ms" in note for note in drive.notes)
    drive = opened(left, right, *sides, MOUNTED, camera=sides_of(pair_tolerance_s=0.002))
    assert drive.problems["right_pictures_without_partner"] == COUNT


@given(
    st.lists(st.integers(0, 60), max_size=8, unique=True),
    st.lists(st.integers(0, 60), max_size=8, unique=True),
    st.integers(0, 6),
)
def test_pairs_are_nearest_and_used_once(ours: list[int], theirs: list[int], most: int) -> None:
    a, b = (np.array(sorted(stamps), dtype=np.int64) for stamps in (ours, theirs))
    matched = nearest_once(a, b, most)
    used = matched[matched >= 0]
    assert len(set(used.tolist())) == len(used)
    for row, partner in enumerate(matched):
        near = np.abs(b - a[row]).min() if len(b) else 99
        if partner >= 0:
            assert abs(int(b[partner] - a[row])) == near <= most
        elif near <= most:  # another of ours is at least as near to each of its nearest
            others = np.abs(a[:, None] - b[None, np.abs(b - a[row]) == near])
            assert (others.min(axis=0) <= near).all()
