"""The C++ search for pieces against the plain one, and against lines made here."""

from __future__ import annotations

import numpy as np
import pytest

from polemap.detect.lines.pieces import PLAIN, SHORT, PieceRules, plain_pieces, straight_pieces
from polemap.extras import kernel


def _points(seed: int, lines: int, clutter: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    rows = np.arange(100)
    parts = []
    for _ in range(lines):
        start, length = rng.uniform(4, 20), rng.uniform(3, 12)
        x = 4.1 + 0.2 * rows
        x = x[(x > start) & (x < start + length) & (rng.uniform(size=100) < 0.9)]
        y = rng.uniform(-5, 5) + rng.uniform(-0.3, 0.3) * (x - 10.0) + rng.normal(0, 0.02, len(x))
        parts.append(np.column_stack([x, y]))
    scattered = np.column_stack(
        [4.1 + 0.2 * rng.integers(0, 100, clutter), rng.uniform(-6, 6, clutter)]
    )
    points = np.concatenate([*parts, scattered])
    return points, (1000.0 / points[:, 0]).astype(np.int64)


NATIVE = kernel("polemap.detect.native.pieces_kernel")


@pytest.mark.skipif(NATIVE is None, reason="the kernel is not built")
@pytest.mark.parametrize("rules", [PLAIN, SHORT], ids=["plain", "short"])
@pytest.mark.parametrize("seed", range(12))
def test_the_kernel_says_what_the_plain_way_says(seed: int, rules: PieceRules) -> None:
    points, rows = _points(seed, lines=seed % 5, clutter=20 * seed)
    plain, fast = plain_pieces(points, rows, rules), straight_pieces(points, rows, rules)
    assert len(plain) == len(fast)
    for one, two in zip(plain, fast, strict=True):
        assert sorted(one.members.tolist()) == sorted(two.members.tolist())
        assert one.rows == two.rows
        for name in ("middle_m", "offset_m", "slope", "start_m", "end_m", "rms_m", "share"):
            assert getattr(two, name) == pytest.approx(getattr(one, name), abs=1e-9)


def test_a_line_is_found_once_and_clutter_is_none() -> None:
    x = 4.1 + 0.2 * np.arange(90)
    line = np.column_stack([x, 2.0 + 0.05 * x])
    found = straight_pieces(line, np.arange(90))
    assert sum(piece.length_m for piece in found) <= np.ptp(x) + 1e-9
    for piece in found:
        assert piece.at(0.0) == pytest.approx(2.0, abs=1e-6)
        assert piece.slope == pytest.approx(0.05, abs=1e-6)
    points, rows = _points(3, lines=0, clutter=150)
    assert straight_pieces(points, rows) == []


def test_a_gap_ends_a_piece_and_few_rows_are_none() -> None:
    x = np.concatenate([4.1 + 0.2 * np.arange(20), 12.1 + 0.2 * np.arange(20)])
    line = np.column_stack([x, np.full(40, 1.0)])
    for piece in straight_pieces(line, np.arange(40)):
        assert piece.end_m < 8.2 or piece.start_m > 12.0
    assert straight_pieces(line, np.arange(40) // 10) == []


@pytest.mark.skipif(NATIVE is None, reason="the kernel is not built")
def test_the_kernel_refuses_what_it_cannot_place() -> None:
    points, rows = _points(1, 1, 5)
    points[0, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        straight_pieces(points, rows)
    with pytest.raises(ValueError, match="rows"):
        straight_pieces(points[1:], rows)
