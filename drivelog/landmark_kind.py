"""Classes of landmarks; a second one begins here.

A further class (signs, trunks, kerb corners) is a further `LandmarkKind`, and its detector fills
rows of that kind. From there on the column decides: tracks, traversals, poles of the map and what
the particle filter matches are associated within a kind, and a map file names the kinds of its rows
where not all are poles. A filter leaves out what its map holds none of.
"""

from __future__ import annotations

from enum import IntEnum


class LandmarkKind(IntEnum):
    """Classes of landmarks, as the column `kind` of the detections names them."""

    POLE = 0
