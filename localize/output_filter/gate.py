"""The chi-square gate of the output filter: one for poses, odometry and fixes.

A measurement fails if its squared Mahalanobis distance (NIS) is one that right measurements exceed
with a probability of `1 - share` only. What follows a pose that failed is in `failed_gate.py`.

Source: Bar-Shalom, Li and Kirubarajan (2001).
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

from polemap.localize.output_filter.config import OutputConfig
from polemap.vehicle.kalman import chi_square_gate

# shares of right measurements that pass
_ODOMETRY_SHARE, _GNSS_SHARE = 0.9999, 0.99


class GateLimits(NamedTuple):
    """Largest NIS that passes: of poses (three degrees of freedom), of odometry and of fixes (two).

    Infinite where the gate is switched off.
    """

    pose: float
    odometry: float
    gnss: float


def gate_limits(config: OutputConfig) -> GateLimits:
    """The limits for shares of right measurements."""
    if not config.gate:
        return GateLimits(inf, inf, inf)
    return GateLimits(
        chi_square_gate(config.pose_gate, 3),
        chi_square_gate(_ODOMETRY_SHARE, 2),
        chi_square_gate(_GNSS_SHARE, 2),
    )


def fails_gate(nis: float, limit: float) -> bool:
    """Whether a measurement of this NIS is not to be taken in."""
    return nis > limit
