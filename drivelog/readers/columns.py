"""Files of a plain drive folder and their columns: what the reader needs, and what it means."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from polemap.drivelog.frames import EarthFrame

_ARRIVAL = {"arrival_s": "when the row reached the computer"}


@dataclass(frozen=True, slots=True)
class FileColumns:
    """Columns of one CSV file by name, each with its meaning."""

    what: str
    required: Mapping[str, str]
    optional: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))


FILES: Mapping[str, FileColumns] = {
    "frames": FileColumns(
        "stereo pairs",
        {
            "stamp_s": "when both pictures were exposed",
            "left": "path of the left picture, inside the folder",
            "right": "path of the right picture",
        },
        _ARRIVAL,
    ),
    "odometry": FileColumns(
        "wheel odometry",
        {
            "stamp_s": "when it was measured",
            "speed_mps": "speed of the rear axle, forward positive",
            "yaw_rate_radps": "yaw rate, counter-clockwise positive",
        },
        _ARRIVAL,
    ),
    "gnss": FileColumns(
        "fixes of the antenna; a local frame has `east_m,north_m` in place of the degrees",
        {
            "stamp_s": "when the fix is valid",
            "latitude_deg": "WGS84",
            "longitude_deg": "WGS84",
        },
        {"hdop": "horizontal dilution of precision, 1 where it is not known", **_ARRIVAL},
    ),
    "reference": FileColumns(
        "poses of the rear axle by a reference system",
        {
            "stamp_s": "when the pose is valid",
            "east_m": "in the drive's frame",
            "north_m": "in the drive's frame",
            "yaw_rad": "counter-clockwise from grid east",
        },
        {"sd_m": "standard deviation of the position on each axis"},
    ),
    "poles": FileColumns(
        "poles detected elsewhere, several rows a stamp",
        {
            "stamp_s": "when the detector looked",
            "x_m": "ahead of the rear axle",
            "y_m": "to the left",
            "var_x_m2": "variance of x",
            "var_y_m2": "variance of y",
            "cov_xy_m2": "their covariance",
        },
        {
            "width_m": "diameter",
            "probability": "that it is a pole",
            "kind": "pole, or corner of a house, a wall, a gate; a pole where empty",
            "facing_rad": "of a corner: into its free side, counter-clockwise from forward",
            **_ARRIVAL,
        },
    ),
    "lines": FileColumns(
        "straight pieces of lines that a detector saw, several rows a stamp",
        {
            "stamp_s": "when the detector looked",
            "kind": "lane_marking, kerb or facade",
            "x0_m": "one end, ahead of the rear axle",
            "y0_m": "to the left",
            "x1_m": "the other end",
            "y1_m": "to the left",
            "offset_sd_m": "standard deviation of its middle across it, shared errors included",
            "direction_sd_rad": "standard deviation of its direction",
        },
        {
            "style": "unknown, solid, dashed or double",
            "probability": "that it is a line of its kind",
            **_ARRIVAL,
        },
    ),
    "scans": FileColumns(
        "every look of the detector of poles.csv, so that an empty one counts",
        {"stamp_s": "when the detector looked"},
    ),
    "laps": FileColumns(
        "named parts",
        {
            "lap": "name",
            "start_s": "first stamp",
            "end_s": "stamp at which it has ended",
        },
    ),
}


def required_columns(name: str, frame: EarthFrame | None = None) -> list[str]:
    """Columns that a file must have; of gnss.csv those of the frame, none of them without one."""
    columns = list(FILES[name].required)
    if name == "gnss" and (frame is None or not frame.is_utm):
        columns = ["stamp_s", *(("east_m", "north_m") if frame is not None else ())]
    return columns
