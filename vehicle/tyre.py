"""Brush tyres: under combined slip for the plant, and across alone with its slope for filters."""

from __future__ import annotations

from math import sqrt


def brush_force(
    slip_x: float, slip_y: float, stiffness_x_n: float, stiffness_y_n: float, limit_n: float
) -> tuple[float, float]:
    """Longitudinal and lateral force of one tyre.

    Args:
        slip_x: theoretical longitudinal slip (r omega - v_x) / |r omega|, positive when driving.
        slip_y: theoretical lateral slip v_y / |r omega|, positive when the tyre slides left.
        stiffness_x_n: longitudinal slip stiffness.
        stiffness_y_n: cornering stiffness per radian.
        limit_n: friction times load.

    Returns:
        Force forward and force to the left; their length never exceeds `limit_n`.

    Source: combined-slip brush model with parabolic pressure (Pacejka, Tyre and Vehicle Dynamics,
    3rd ed., ch. 3): F = g - g^2 / (3 L) + g^3 / (27 L^2) up to full sliding at g = 3 L.
    """
    demand_x, demand_y = stiffness_x_n * slip_x, stiffness_y_n * slip_y
    demand = sqrt(demand_x * demand_x + demand_y * demand_y)
    if demand <= 0.0 or limit_n <= 0.0:
        return 0.0, 0.0
    if demand >= 3.0 * limit_n:
        force = limit_n
    else:
        force = demand - demand**2 / (3.0 * limit_n) + demand**3 / (27.0 * limit_n**2)
    share = force / demand
    return share * demand_x, -share * demand_y


def brush_lateral(slip_rad: float, stiffness_nprad: float, limit_n: float) -> tuple[float, float]:
    """Lateral force of a tyre or an axle, and its derivative by the slip angle.

    Args:
        slip_rad: direction of the contact patch's motion less the wheel's, left positive.
        stiffness_nprad: cornering stiffness at no slip, positive.
        limit_n: the most it can carry across, positive.

    Returns:
        Force to the left, and its slope (never positive; 0 from full sliding on).

    Source: brush model with parabolic pressure in the form of Fiala (Pacejka, Tyre and Vehicle
    Dynamics, 3rd ed., ch. 3): F = L (1 - (1 - z)^3) with z = C |alpha| / (3 L).
    """
    used = stiffness_nprad * abs(slip_rad) / (3.0 * limit_n)
    if used >= 1.0:
        return (-limit_n if slip_rad > 0.0 else limit_n), 0.0
    left = 1.0 - used
    force = limit_n * (1.0 - left * left * left)
    return (-force if slip_rad > 0.0 else force), -stiffness_nprad * left * left
