"""TUM files: what is written reads back to the bit, and what is damaged is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.drivelog.errors import InputError
from polemap.drivelog.tum import read_tum, tum_text, write_tum
from polemap.vehicle.trajectory import Trajectory


@given(
    st.lists(
        st.tuples(st.floats(-1e6, 1e6), st.floats(-6e6, 6e6), st.floats(-3.1, 3.1)),
        min_size=1,
        max_size=20,
    )
)
def test_tum_round_trip(rows: list[tuple[float, float, float]]) -> None:
    import tempfile

    track = Trajectory(1.7e9 + np.arange(len(rows)) / 100.0, np.array(rows))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "t.tum"
        path.write_text(tum_text(track))
        back = read_tum(path)
    assert np.allclose(back.stamp_s, track.stamp_s, atol=1e-6, rtol=0)
    assert np.array_equal(back.poses[:, :2], track.poses[:, :2])
    assert np.allclose(back.poses[:, 2], track.poses[:, 2], atol=1e-12)


def test_repeated_and_backward_stamps_are_dropped(tmp_path: Path) -> None:
    path = tmp_path / "t.tum"
    path.write_text("".join(f"{t} {x} 0 0 0 0 0 1\n" for x, t in enumerate((1, 2, 2, 1.5, 3))))
    assert read_tum(path).stamp_s.tolist() == [1.0, 2.0, 3.0]


def test_a_trajectory_in_utm_keeps_full_precision(tmp_path: Path) -> None:
    stamps = np.array([1317375912.01, 1317375912.02])
    poses = np.array([[391234.123456789, 5819876.987654321, 3.1], [1.0, 2.0, -3.1]])
    write_tum(tmp_path / "a.tum", Trajectory(stamps, poses, np.zeros((2, 3, 3))))
    again = read_tum(tmp_path / "a.tum")
    assert np.array_equal(again.stamp_s, stamps)
    assert np.array_equal(again.poses[:, :2], poses[:, :2])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3\n", "a.tum:1: 3 numbers; expected eight numbers 'stamp x y z qx qy qz qw'"),
        ("# good\n1 2 3 4 5 6 7 x\n", "a.tum:2: '1 2 3 4 5 6 7 x' is not a TUM pose"),
        ("1 2 3 4 5 6 7 nan\n", "a.tum: pose 1 has qw = nan; every value .* must be finite"),
        ("# nothing\n", "a.tum: holds no pose"),
    ],
)
def test_a_damaged_trajectory_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "a.tum"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_tum(path)


def test_what_is_no_text_or_no_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.tum: no such trajectory"):
        read_tum(tmp_path / "none.tum")
    (tmp_path / "a.tum").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match=r"a\.tum: is not a text file"):
        read_tum(tmp_path / "a.tum")
    with pytest.raises(InputError, match="no such trajectory"):
        read_tum(tmp_path)
