"""Pictures: whether a pair is a pair, by a handful of features in a handful of frames."""

from __future__ import annotations

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding


def check_pictures(drive: Drive) -> list[Finding]:
    """What in the stereo pairs of a drive cannot be right, from a few of them."""
    return []
