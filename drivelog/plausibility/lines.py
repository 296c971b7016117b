"""Lines whose numbers cannot be metres and radians."""

from __future__ import annotations

import numpy as np

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.line_detections import LineDetections

_FAR_M, _NEAR_M = 200.0, 0.5
# medians: beyond 17 degrees a direction says nothing of a line; detectors state 0.2 to 3
_DIRECTION_SD_RAD = 0.3
_OFFSET_SD_M = (1e-3, 2.0)
_PROBABILITY = (0.0, 1.0)


def line_findings(drive: Drive) -> list[Finding]:
    """Ranges, deviations and probabilities of lines that were detected elsewhere."""
    seen = [scan.lines for scan in drive.scans if scan.lines is not None and len(scan.lines)]
    return _lines(LineDetections.concatenate(seen), drive.names.lines) if seen else []


def _lines(lines: LineDetections, name: str) -> list[Finding]:
    distance = float(np.median(np.hypot(*lines.middle_vehicle_m.T)))
    turn, offset = float(np.median(lines.direction_sd_rad)), float(np.median(lines.offset_sd_m))
    probability = float(np.median(lines.probability))
    found = []
    if not _NEAR_M < distance < _FAR_M:
        found.append(
            Finding(
                "line_range", "error", name, f"lines {distance:.3g} m away in the median",
                f"{_NEAR_M:g} to {_FAR_M:g} m", "write both ends in metres, in the vehicle frame",
            )
        )  # fmt: skip
    if turn > _DIRECTION_SD_RAD:
        found.append(
            Finding(
                "line_direction_sd", "error", name,
                f"direction_sd_rad is {turn:.3g} in the median, {np.degrees(turn):.0f} degrees",
                f"below {_DIRECTION_SD_RAD:g}", "write it in radians, 0.01 for 0.6 degrees",
            )
        )  # fmt: skip
    if not _OFFSET_SD_M[0] <= offset <= _OFFSET_SD_M[1]:
        found.append(
            Finding(
                "line_offset_sd", "error" if offset > _OFFSET_SD_M[1] else "warning", name,
                f"offset_sd_m is {offset:.3g} in the median",
                f"{_OFFSET_SD_M[0]:g} to {_OFFSET_SD_M[1]:g} m",
                "write standard deviations in metres, no variances",
            )
        )  # fmt: skip
    if not _PROBABILITY[0] <= probability <= _PROBABILITY[1]:
        found.append(
            Finding(
                "line_probability", "error", name,
                f"probability is {probability:.3g} in the median", "from 0 to 1",
                "write 0.9 for 90 percent, or leave the column out",
            )
        )  # fmt: skip
    return found
