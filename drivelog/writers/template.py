"""A drive folder to fill: drive.yaml with every key explained, CSV files with headers alone."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from pydantic import BaseModel

from polemap.drivelog.atomic import atomic_folder
from polemap.drivelog.errors import OutputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.problems import CHOOSE
from polemap.drivelog.readers.columns import FILES, required_columns
from polemap.drivelog.readers.drive_yaml import DriveYaml
from polemap.drivelog.readers.drive_yaml_parts import (
    AntennaPart,
    CameraPart,
    DetectorPart,
    MountingPart,
    OdometryPart,
)

_HEAD = """\
# A plain drive folder. Give what says CHOOSE; delete the CSV files of sensors that the car does not
# have. `polemap info` tells what is missing or wrong. docs/drives.md explains the format.
"""


def check_new(path: Path) -> None:
    """Refuse a place where something stands.

    Raises:
        OutputError: a file, or a folder that is not empty.
    """
    if path.is_file() or (path.is_dir() and any(path.iterdir())):
        raise OutputError(f"{path}: is there already, and is not overwritten; give another name")


def write_template(
    path: Path,
    *,
    frame: EarthFrame | None,
    wheelbase_m: float | None,
    sensors: Sequence[str],
    allow_links: bool = False,
) -> None:
    """Write a drive folder to fill.

    Args:
        path: where nothing stands yet.
        frame: None leaves it to be chosen.
        wheelbase_m: None likewise.
        sensors: names of `FILES`.
        allow_links: pictures may lie outside of the folder.

    Raises:
        OutputError: something stands there, or it cannot be written to.
    """
    check_new(path)
    with atomic_folder(path, "drive") as folder:
        own_name = os.path.basename(os.path.realpath(path))
        text = _drive_yaml(own_name, frame, wheelbase_m, sensors, allow_links)
        (folder / "drive.yaml").write_text(text, encoding="utf-8")
        for name in sensors:
            columns = required_columns(name, frame or EarthFrame("utm", 32632))
            columns += [column for column in FILES[name].optional if column != "arrival_s"]
            header = ",".join(columns) + "\n"
            (folder / f"{name}.csv").write_text(header, encoding="utf-8")


def _drive_yaml(
    name: str,
    frame: EarthFrame | None,
    wheelbase_m: float | None,
    sensors: Sequence[str],
    allow_links: bool,
) -> str:
    stated = CHOOSE
    if frame is not None:
        stated = ", ".join(f"{key}: {json.dumps(v)}" for key, v in frame.to_dict().items())
        stated = f"{{{stated}}}"
    lines = [
        _HEAD,
        "format_version: 1",
        f"name: {json.dumps(name, ensure_ascii=False)}",
        f"frame: {stated}  # {_explained(DriveYaml, 'frame')}",
        "vehicle:",
        f"  wheelbase_m: {CHOOSE if wheelbase_m is None else wheelbase_m}"
        "  # from the rear to the front axle",
        "  # car: my_car.yaml  # instead: a car of `polemap estimate --list`, or a car file",
    ]
    camera = [
        "camera:  # of the rectified pair; a raw one has, in place of the keys up to baseline_m,",
        "  # calibration: camchain.yaml  # or [left.yaml, right.yaml]; see docs/calibration.md",
    ]
    camera += _keys(CameraPart, skip="vehicle_from_camera")
    camera.append("  vehicle_from_camera:  # the left camera, from the rear axle on the ground")
    camera += [f"  {line}" for line in _keys(MountingPart)]
    lines += camera if "frames" in sensors else _commented(camera)
    correction = ["odometry:  # what `polemap calibrate` finds", *_keys(OdometryPart)]
    lines += _commented(correction)
    lines += _commented(["gnss_antenna:", *_keys(AntennaPart)])
    detector = ["pole_detector:  # of poles.csv", *_keys(DetectorPart)]
    lines += _commented(detector)
    lines += ["# notes: [wet road]  # shown with every result"]
    links = f"allow_links: true  # {_explained(DriveYaml, 'allow_links')}"
    lines.append(links if allow_links else f"# {links}")
    return "\n".join(lines) + "\n"


def _keys(model: type[BaseModel], skip: str = "") -> list[str]:
    lines = []
    for name, field in model.model_fields.items():
        if name == skip:
            continue
        explained = _explained(model, name)
        if field.is_required():
            lines.append(f"  {name}: {CHOOSE}  # {explained}")
        elif field.default is None:
            lines.append(f"  # {name}: {(field.examples or [''])[0]}  # {explained}")
        else:
            lines.append(f"  {name}: {field.default}  # {explained}")
    return lines


def _explained(model: type[BaseModel], name: str) -> str:
    field = model.model_fields[name]
    return f"{field.description}, such as {(field.examples or [''])[0]}"


def _commented(lines: list[str]) -> list[str]:
    return [f"# {line}" for line in lines]
