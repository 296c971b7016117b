"""How markings are drawn, from the gaps along them: solid, dashed, double."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from polemap.detect.lines.pieces import Piece
from polemap.drivelog.landmark_kind import LineStyle

_DOUBLE_M = 0.42  # between the middles of a double line
_GAP_M = 1.5  # between the dashes of a dashed line
_SOLID_M = 6.0  # without a gap: longer than the dashes of streets and country roads
_OFF_M, _TURNED = 0.4, 0.12  # by which pieces of one line may miss each other


def line_styles(pieces: list[Piece]) -> tuple[list[Piece], list[LineStyle]]:
    """The pieces with double ones made one, and the style of each."""
    order = sorted(pieces, key=lambda piece: piece.start_m)
    single: list[Piece] = []
    double: list[bool] = []
    for piece in order:
        twin = next((k for k, other in enumerate(single) if _parallel(piece, other)), None)
        if twin is None:
            single.append(piece)
            double.append(False)
        else:
            single[twin], double[twin] = _between(single[twin], piece), True
    styles = [
        LineStyle.DOUBLE if twice else _style(piece, single)
        for piece, twice in zip(single, double, strict=True)
    ]
    return single, styles


def _overlap(one: Piece, two: Piece) -> float:
    return min(one.end_m, two.end_m) - max(one.start_m, two.start_m)


def _parallel(one: Piece, two: Piece) -> bool:
    """Whether two pieces run beside each other as the two of a double line do."""
    if _overlap(one, two) < 0.6 * max(one.length_m, two.length_m):
        return False
    middle = 0.5 * (max(one.start_m, two.start_m) + min(one.end_m, two.end_m))
    return abs(one.at(middle) - two.at(middle)) < _DOUBLE_M


def _between(one: Piece, two: Piece) -> Piece:
    """The middle of a double line, where both are seen."""
    start, end = max(one.start_m, two.start_m), min(one.end_m, two.end_m)
    middle = 0.5 * (start + end)
    return replace(
        one,
        middle_m=middle,
        offset_m=0.5 * (one.at(middle) + two.at(middle)),
        slope=0.5 * (one.slope + two.slope),
        start_m=start,
        end_m=end,
        rms_m=max(one.rms_m, two.rms_m),
        rows=min(one.rows, two.rows),
    )


def _style(piece: Piece, pieces: list[Piece]) -> LineStyle:
    """From the gaps to the pieces before and behind it, and the length without one."""
    line = [p for p in pieces if p is piece or _continues(piece, p)]
    line.sort(key=lambda p: p.start_m)
    gaps = [after.start_m - before.end_m for before, after in pairwise(line)]
    if any(gap >= _GAP_M for gap in gaps):
        return LineStyle.DASHED
    length = line[-1].end_m - line[0].start_m
    return LineStyle.SOLID if length >= _SOLID_M else LineStyle.UNKNOWN


def _continues(one: Piece, two: Piece) -> bool:
    """Whether two pieces lie on one line; bends turn it on the way."""
    if _overlap(one, two) > 0.3:
        return False
    middle = 0.5 * (one.middle_m + two.middle_m)
    apart = abs(one.middle_m - two.middle_m)
    return bool(
        abs(one.at(middle) - two.at(middle)) < _OFF_M
        and abs(np.arctan(one.slope) - np.arctan(two.slope)) < _TURNED
        and apart < 16.0
    )
