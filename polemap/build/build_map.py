"""Map building on one screen: drives to scans, traversal landmarks, poles, evidence, map."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from polemap.build.assemble import BuiltMap, assemble_map
from polemap.build.config import MappingConfig
from polemap.build.drive_observations import DriveObservations, observe_drive
from polemap.config import PolemapConfig
from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.map.pole_map import PoleMap

Scan = Callable[[Drive], Sequence[Detections]]

__all__ = ["BuiltMap", "Scan", "assemble_map", "build_map", "observe", "unique_names"]


def build_map(
    drives: Sequence[Drive],
    config: PolemapConfig,
    scan: Scan,
    *,
    frame: EarthFrame | None = None,
    update: PoleMap | None = None,
    align: bool = False,
) -> BuiltMap:
    """Build one map from drives with reference poses, or bring a map up to date.

    Args:
        drives: each with a reference; drives in a neighbouring UTM zone are transformed.
        config: settings of this room.
        scan: gives the pole scans of a drive (`polemap.perception.scan_drive` does).
        frame: of the map; that of `update` or of the first drive where it is not given.
        update: a map to bring up to date.
        align: lay drives onto each other before merging, where their references disagree.

    Raises:
        InputError: no drives, a drive without a reference, or without scans.
        FrameError: frames that no transformation joins.
    """
    if not drives:
        raise InputError("a map needs at least one drive")
    frame = frame or (update.frame if update is not None else drives[0].frame)
    observed = [
        observe(drive, name, scan(drive), config.mapping, frame)
        for drive, name in zip(drives, unique_names(drives), strict=True)
    ]
    return assemble_map(observed, config.mapping, frame, update=update, align=align)


def unique_names(drives: Iterable[Drive]) -> list[str]:
    """Names of the drives, told apart where two have the same."""
    names: list[str] = []
    for drive in drives:
        name, count = drive.name, 2
        while name in names:
            name, count = f"{drive.name} ({count})", count + 1
        names.append(name)
    return names


def observe(
    drive: Drive, name: str, scans: Sequence[Detections], config: MappingConfig, frame: EarthFrame
) -> DriveObservations:
    """What one drive contributes to a map in `frame`.

    Raises:
        InputError: the drive has no reference, or none where it looked.
        FrameError: no transformation leads from the drive's frame to `frame`.
    """
    if drive.reference is None or not len(drive.reference):
        raise InputError(
            f"drive {drive.name}: it has no reference poses; a map is built from where the car "
            f"was: add {drive.names.reference}"
        )
    # given poles were detected by something else
    rig = drive.rig if drive.has_frames else None
    gain = rig.focal_px * rig.baseline_m if rig is not None else None
    return observe_drive(name, drive.frame, scans, drive.reference, config, frame, gain)
