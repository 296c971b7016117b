"""Classes of landmarks; a second one begins here.

A further class (signs, trunks, kerb corners) is a further `LandmarkKind`: its detector fills rows
of that kind, tracks and traversals are associated within a kind, and a map or a filter takes the
kinds that it knows with `Detections.of_kind`.
"""

from __future__ import annotations

from enum import IntEnum


class LandmarkKind(IntEnum):
    """Classes of landmarks, as the column `kind` of the detections names them."""

    POLE = 0
