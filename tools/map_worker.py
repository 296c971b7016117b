"""What a worker of `polemap map --workers` does: one drive, from its path to its observations."""

from __future__ import annotations

from polemap.build.build_map import observe
from polemap.build.city.work import DriveTask
from polemap.build.drive_observations import DriveObservations
from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.perception import scan_drive
from polemap.settings import Settings
from polemap.tools.drive_detection import Source
from polemap.tools.progress import Advance


def scan(drive: Drive, settings: Settings, advance: Advance) -> list[Detections]:
    """Poles in the images; poles that were detected elsewhere go to the building as they are.

    The building joins detections over whole traversals with the reference, which beats any
    tracking on odometry: a tracker before it would only lose some.
    """
    if drive.has_frames:
        return scan_drive(drive, settings.polemap, advance, stereo=settings.stereo)
    if not drive.scans:
        raise InputError(f"drive {drive.name}: it has neither images nor {drive.names.poles}")
    advance(len(drive.scans))
    return list(drive.scans)


def observe_task(task: DriveTask) -> DriveObservations:
    """Detect the poles of one drive and give what it contributes to the map."""
    settings = Settings.model_validate_json(task.settings)
    drive = Source(task.path, task.lap, task.topics, task.odometry).open(task.seed)
    scans = scan(drive, settings, lambda _steps: None)
    return observe(drive, task.name, scans, settings.polemap.mapping, task.frame)
