"""Classes of landmarks: points that stand beside the road, and lines along it.

From the detector to the map and the filters the class decides: tracks, traversals, landmarks of the
map and what the particle filter matches are associated within a kind, and a map file names the
kinds of its rows where not all are poles. A filter leaves out what its map holds none of.

Points (poles, corners) are rows of `Detections`; lines are rows of its `lines`.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray


class LandmarkKind(IntEnum):
    """Classes of landmarks, as the column `kind` names them."""

    POLE = 0
    CORNER = 1  # vertical edge of a house, a wall, a gate: a point with a free side
    LANE_MARKING = 2
    KERB = 3
    FACADE = 4  # wall of a house, seen from above


POINT_KINDS = frozenset({LandmarkKind.POLE, LandmarkKind.CORNER})
LINE_KINDS = frozenset({LandmarkKind.LANE_MARKING, LandmarkKind.KERB, LandmarkKind.FACADE})


def kind_counts(kinds: NDArray[np.int8]) -> str:
    """How many of each, such as "12 poles, 3 lane markings"; empty without any."""
    told = []
    for kind, count in zip(*np.unique(kinds, return_counts=True), strict=True):
        known = kind in LandmarkKind.__members__.values()
        told.append(f"{count} {kind_name(kind)}{'s' if known and count != 1 else ''}")
    return ", ".join(told)


def kind_name(kind: int) -> str:
    """A kind for readers: "lane marking"; "of kind 7" of one that no release knows yet."""
    known = kind in LandmarkKind.__members__.values()
    return LandmarkKind(kind).name.lower().replace("_", " ") if known else f"of kind {kind}"


class LineStyle(IntEnum):
    """How a line is drawn, as the column `style` of lines names it."""

    UNKNOWN = 0
    SOLID = 1
    DASHED = 2
    DOUBLE = 3
