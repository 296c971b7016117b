"""`drive.yaml`: what a plain drive folder says about itself.

The description and example of a key are what the error about it, `polemap new` and the page
docs/drives.md say.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    Discriminator,
    Field,
    Tag,
    ValidationError,
)

from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.problems import refusal, validation_mistakes
from polemap.drivelog.readers.drive_yaml_parts import (
    AntennaPart,
    CameraPart,
    DetectorPart,
    OdometryPart,
    Part,
    RawCameraPart,
    VehiclePart,
    printable,
)
from polemap.parsing.errors import named
from polemap.parsing.yaml_text import read_yaml

LONGEST_NAME = 200
# names of the two kinds of camera; they stand in no file and no message
_RECTIFIED, _RAW = "<rectified>", "<raw>"


def _earth_frame(values: dict[str, Any]) -> dict[str, Any]:
    try:
        EarthFrame.from_dict(values)
    except InputError as error:
        raise ValueError(str(error).removeprefix("frame: ")) from error
    return values


def _kind_of_camera(value: Any) -> str:
    """Which of the two kinds of `camera` is meant; a calibration file says raw."""
    raw = "calibration" in value if isinstance(value, dict) else isinstance(value, RawCameraPart)
    return _RAW if raw else _RECTIFIED


class DriveYaml(Part):
    """All of drive.yaml; keys that are not known are kept aside and noted."""

    format_version: Literal[1] = Field(description="the version of this format", examples=[1])
    name: Annotated[
        str,
        Field(
            min_length=1,
            max_length=LONGEST_NAME,
            description="what the drive is called",
            examples=["campus_lap_1"],
        ),
        AfterValidator(printable),
    ]
    frame: Annotated[dict[str, Any], AfterValidator(_earth_frame)] = Field(
        description="the plane of all coordinates: a UTM zone, or {kind: local, name: ...}",
        examples=["{kind: utm, epsg: 32633}"],
    )
    vehicle: VehiclePart = Field(
        description="the car: wheelbase_m, or car", examples=["{wheelbase_m: 2.71}"]
    )
    camera: (
        Annotated[
            Annotated[CameraPart, Tag(_RECTIFIED)] | Annotated[RawCameraPart, Tag(_RAW)],
            Discriminator(_kind_of_camera),
        ]
        | None
    ) = Field(None, description="the stereo pair: rectified, or raw with its calibration file")
    odometry: OdometryPart | None = Field(
        None,
        description="what odometry.csv is corrected by",
        examples=["{speed_scale: 1.012, delay_s: 0.08}"],
    )
    gnss_antenna: AntennaPart | None = Field(
        None, description="where the GNSS antenna is", examples=["{x_m: 0.5, y_m: 0.0}"]
    )
    pole_detector: DetectorPart | None = Field(
        None, description="where the detector behind poles.csv could have seen a pole"
    )
    notes: tuple[Annotated[str, AfterValidator(printable)], ...] = Field(
        (), description="texts that are shown with every result", examples=["[wet road]"]
    )
    allow_links: bool = Field(
        False,
        description="whether pictures may lie outside of the folder, by links or absolute paths",
        examples=["true"],
    )

    def unknown_keys(self) -> list[str]:
        """Dotted names of the keys that nothing reads."""
        names = list(self.model_extra or {})
        for part in ("vehicle", "camera", "odometry", "gnss_antenna", "pole_detector"):
            value = getattr(self, part)
            if value is not None:
                names += [f"{part}.{key}" for key in value.model_extra or {}]
        return names


def read_drive_yaml(path: Path) -> DriveYaml:
    """Read and check a drive.yaml.

    Raises:
        InputError: unreadable, no YAML, a key missing or a value out of its range; several such
            keys at once as `Mistakes`.
    """
    with named(path, InputError, "drive.yaml"):
        values = read_yaml(path)
    if not isinstance(values, dict):
        raise InputError(f"{path}: holds no keys; see the plain drive folder in docs/drives.md")
    try:
        return DriveYaml.model_validate(values)
    except ValidationError as error:
        raise refusal(path, validation_mistakes(error, DriveYaml)) from error
