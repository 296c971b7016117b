"""Drives to a pole map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from polemap.api.plausible import check
from polemap.build import build_map as building
from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.map.pole_map import PoleMap
from polemap.perception import scan_drive
from polemap.settings import Settings


def build_map(
    drives: Drive | Sequence[Drive],
    settings: Settings | None = None,
    *,
    update: PoleMap | None = None,
    align: bool = False,
    progress: Callable[[int], None] | None = None,
    force: bool = False,
) -> PoleMap:
    """Build one pole map from drives with reference poses, or bring a map up to date.

    Args:
        drives: one or many; each with a reference, and images or poles of its own.
        settings: the defaults where not given.
        update: a map to bring up to date with the drives.
        align: lay the drives onto each other first, where their references disagree.
        progress: called with the number of frames done since the last call.
        force: go on with drives that cannot be right; what is doubtful is warned of either way.

    Returns:
        The map; what there is to know about its making stands in its `notes`.

    Raises:
        InputError: no drive, one without reference poses, without images and poles, or one whose
            streams contradict each other.
        FrameError: drives in frames that no transformation joins.
    """
    chosen = settings or Settings()

    def scans(drive: Drive) -> Sequence[Detections]:
        if drive.has_frames or not drive.scans:
            return scan_drive(drive, chosen.polemap, progress, stereo=chosen.stereo)
        # the building joins detections over whole traversals, which tracking could only make fewer
        return drive.scans

    several = [drives] if isinstance(drives, Drive) else list(drives)
    for drive in several:
        check(drive, force=force)
    built = building.build_map(several, chosen.polemap, scans, update=update, align=align)
    return replace(built.pole_map, notes=(*built.pole_map.notes, *map(str, built.reports)))
