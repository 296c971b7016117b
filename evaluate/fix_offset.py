"""Do the fixes lie to one side of the poses that poles hold, by more than their error allows?

A map that stands aside or turned as a whole makes poses that agree with its poles and with
odometry. The fixes alone know better, and only over minutes: their error wanders, and the variance
of its mean over a drive is that of a Gauss-Markov process, sigma^2 times the mean correlation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.localize.config import GnssConfig
from polemap.localize.replay import Run
from polemap.vehicle.pose import rotate

Floats = NDArray[np.float64]

# the correlation is summed over so many fixes of a drive, evenly taken
_MOST_FIXES = 500
# a median of normal errors scatters so much more than a mean
_MEDIAN = 1.2533
# standard deviations, and metres, beyond which it is named: 6e-5, and what frames of the earth
# differ by (WGS84 and ETRS89: 0.8 m)
_LARGEST_SD, _LEAST_M = 4.0, 1.5


@dataclass(frozen=True, slots=True)
class FixOffset:
    """How the fixes lie to the poses, and by how much chance may make it.

    Attributes:
        east_m, north_m: median offset of the fixes.
        sd_m: of it, an axis, if the receiver errs as stated.
        turn_rad: turn of the fixes' places about their middle, against the poses.
        turn_sd_rad: of it.
        reach_m: distance from the middle of the farthest fix.
    """

    east_m: float
    north_m: float
    sd_m: float
    turn_rad: float
    turn_sd_rad: float
    reach_m: float

    @property
    def distance_m(self) -> float:
        """Length of the offset."""
        return float(np.hypot(self.east_m, self.north_m))

    @property
    def finding(self) -> str:
        """What stands aside or turned, "" where chance explains it."""
        if self.distance_m > max(_LARGEST_SD * self.sd_m, _LEAST_M):
            return (
                f"fixes lie {self.distance_m:.1f} m (east {self.east_m:.1f}, north "
                f"{self.north_m:.1f}) from the pose all along, their error explains "
                f"{_LARGEST_SD * self.sd_m:.1f} m: map or fixes stand in another frame"
            )
        turned = abs(self.turn_rad)
        if turned > _LARGEST_SD * self.turn_sd_rad and turned * self.reach_m > _LEAST_M:
            return (
                f"fixes lie turned by {np.degrees(self.turn_rad):.1f} degrees about the poses: map "
                "or fixes stand in another frame"
            )
        return ""


def fix_offset(run: Run, drive: Drive, gnss: GnssConfig) -> FixOffset | None:
    """The offset of the fixes from the healthy poses of the output; None with fewer than three.

    Args:
        run: of the drive.
        drive: with its fixes and the place of the antenna.
        gnss: what is stated of the receiver.
    """
    fixes = drive.gnss
    stamps = run.kf.stamp_s
    if fixes is None or len(stamps) < 2 or len(run.distrust) != len(stamps):
        return None
    healthy = np.array([not reason for reason in run.distrust], dtype=bool)
    nearest = np.clip(np.searchsorted(stamps, fixes.stamp_s), 0, len(stamps) - 1)
    inside = (fixes.stamp_s >= stamps[0]) & (fixes.stamp_s <= stamps[-1]) & healthy[nearest]
    if np.count_nonzero(inside) < 3:
        return None
    poses = run.kf.poses[nearest[inside]]
    places = poses[:, :2] + rotate(np.asarray(drive.gnss_antenna_m), poses[:, 2])
    seen = np.column_stack([fixes.east_m[inside], fixes.north_m[inside]])
    offset = np.median(seen - places, axis=0)
    when = fixes.stamp_s[inside]
    when = when[:: max(1, len(when) // _MOST_FIXES)]
    apart = np.abs(when[:, None] - when) / max(gnss.correlation_s, 1e-9)
    alike = float(np.exp(-apart).mean())
    sd_m = _MEDIAN * gnss.sd_m * float(np.median(fixes.hdop[inside])) * np.sqrt(alike)
    arm = places - places.mean(axis=0)
    across = np.stack([-arm[:, 1], arm[:, 0]], axis=1)
    # bounded, so that single wild fixes turn nothing
    rest = np.clip(seen - places - offset, -3.0 * gnss.sd_m, 3.0 * gnss.sd_m)
    square = float(np.mean(np.sum(arm**2, axis=1)))
    turn = float(np.mean(np.sum(across * rest, axis=1))) / max(square, 1e-9)
    return FixOffset(
        float(offset[0]),
        float(offset[1]),
        float(sd_m),
        turn,
        float(sd_m / max(np.sqrt(square), 1e-9)),
        float(np.hypot(*arm.T).max()),
    )
