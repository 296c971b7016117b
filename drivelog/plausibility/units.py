"""Factors between units that are mistaken for one another, so that a finding can name them."""

from __future__ import annotations

from math import log, pi

SPEED_UNITS = {
    3.6: "km/h",
    1.0 / 0.44704: "mph",
    3.6 / 1.852: "knots",
    1.0 / 0.3048: "ft/s",
    100.0: "cm/s",
    1000.0: "mm/s",
    0.001: "km/s",
    1.0 / 3.6: "a km/h value divided twice",
    0.44704: "an mph value converted twice",
}
ANGLE_UNITS = {180.0 / pi: "degrees", pi / 180.0: "radians converted twice", 1000.0: "mrad"}
LENGTH_UNITS = {1000.0: "mm", 100.0: "cm", 0.001: "km", 1.0 / 0.3048: "ft", 1.0 / 0.0254: "inches"}


def named_unit(factor: float, units: dict[float, str], tolerance: float = 0.08) -> str | None:
    """The unit whose factor lies within `tolerance` (relative) of the one seen, else None."""
    if not factor > 0.0:
        return None
    near = min(units, key=lambda known: abs(log(factor / known)))
    return units[near] if abs(log(factor / near)) <= tolerance else None
