"""Where the GNSS antenna stands, by how the fixes swing round the way while the car turns.

The equations are those of `fix_delay`: an error that the fixes share over a minute stays where it
is while the car turns, an antenna turns with it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.fix_delay import Equations, find_equations
from polemap.drivelog.plausibility.odometer import Odometer

Floats = NDArray[np.float64]

_STRETCHES_MIN = 3
# what is known beforehand: receivers are late by this, an antenna may be anywhere
_DELAY_SD_S, _PLACE_SD_M = 0.15, 100.0
# clean drives: within 0.9 m across and 2.8 m along, and 5.2 standard deviations of the fit
_OFF_M, _SDS = 2.0, 7.0


def antenna_findings(drive: Drive, motion: Odometer, *, heading_known: bool) -> list[Finding]:
    """An antenna that stands elsewhere than stated, by metres.

    Args:
        heading_known: the headings of the motion are of the drive's frame (a reference).
    """
    rows = find_equations(drive, motion, heading_known=heading_known)
    if rows is None or rows.stretches < _STRETCHES_MIN:
        return []
    off, sd = find_antenna(rows)
    far = (np.abs(off) > _OFF_M) & (np.abs(off) > _SDS * sd)
    if not far.any():
        return []
    said = [
        f"{abs(off[axis]):.1f} m {words[0] if off[axis] > 0.0 else words[1]}"
        for axis, words in enumerate((("ahead of", "behind"), ("left of", "right of")))
        if far[axis]
    ]
    x, y = drive.gnss_antenna_m + np.where(far, off, 0.0)
    late = ", or its delay" if far[0] and not far[1] else ""
    return [
        Finding(
            "gnss_antenna", "warning", drive.names.gnss,
            f"in bends the fixes go as a point {' and '.join(said)} the stated antenna, held "
            f"against {motion.name} (sd {float(sd[far].max()):.1f} m)",
            f"within {_OFF_M:g} m of gnss_antenna in {drive.names.head}, x "
            f"{drive.gnss_antenna_m[0]:g}, y {drive.gnss_antenna_m[1]:g} m",
            f"measure the antenna's place (x {x:.1f}, y {y:.1f} m would fit){late}",
        )
    ]  # fmt: skip


def find_antenna(rows: Equations) -> tuple[Floats, Floats]:
    """Place of the antenna off the stated one, `(2,)` ahead and left, and its sds, metres."""
    prior = np.diag([_DELAY_SD_S**-2, _PLACE_SD_M**-2, _PLACE_SD_M**-2])
    fit: Floats = np.zeros(3)
    total: Floats = prior
    for _ in range(15):
        rest: Floats = rows.target_m - rows.design @ fit
        scale = 1.4826 * float(np.median(np.abs(rest))) + 1e-3
        weight = rows.weight / (1.0 + (rest / (2.0 * scale)) ** 2) / scale**2
        total = np.asarray((rows.design * weight[:, None]).T @ rows.design + prior)
        vector = rows.design.T @ (weight * rows.target_m)
        fit = np.asarray(np.linalg.solve(total, vector), dtype=np.float64)
    return fit[1:], np.sqrt(np.diag(np.linalg.inv(total))[1:])
