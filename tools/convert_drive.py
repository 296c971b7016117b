"""Drives written in other forms; see `tools/convert.py`."""

from __future__ import annotations

from polemap.drivelog.atomic import check_folder
from polemap.drivelog.drive import open_drive
from polemap.drivelog.writers.folder import write_drive
from polemap.tools.convert import Request


def to_folder(request: Request) -> list[str]:
    """A plain drive folder of any drive, images included."""
    check_folder(request.out, "drive", request.inputs)
    drive = open_drive(request.input, seed=request.seed)
    write_drive(drive, request.out)
    return [f"drive {drive.name} written to {request.out}"]
