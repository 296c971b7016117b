"""Sampling the motion of the particles with the noise alpha 1 to alpha 4 of the paper."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from polemap.localize.config import LocalizeConfig
from polemap.localize.odometry_history import Arc
from polemap.vehicle.motion import arc_displacement
from polemap.vehicle.pose import move_reference_point

Floats = NDArray[np.float64]

# the step that the alphas are given for: odometry at 50 Hz
REFERENCE_STEP_S = 0.02
# what a speed may have changed by in a hole of the odometry: 4 m/s^2 for half a second
_GAP_SPEED_MPS = 2.0


def sample_motion(
    poses: Floats,
    arcs: Iterable[Arc],
    wheelbase_m: float,
    config: LocalizeConfig,
    rng: np.random.Generator,
    slip_rad_per_mps2: Floats | float = 0.0,
    factors: Floats | tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Floats:
    """Front-axle poses `(n, 3)` after the arcs, each particle with its own noise; yaw not wrapped.

    On every arc, speed and yaw rate get zero-mean noise of standard deviation alpha1 and alpha2,
    and the heading an additional turn of standard deviation min(alpha3 |yaw rate|, alpha4), without
    which three dimensions could not be sampled. A standing car does not move: the noise of an arc
    without speed and yaw rate is zero.

    The rear axle does not go where the car points: in a bend its tyres slip outward, which the
    paper leaves out. On an arc of lateral acceleration a it goes in the direction yaw - k a, with
    `slip_rad_per_mps2` k of every particle, `(n,)`.

    `factors` scale the noise along, aside and of the turn (`NoiseScale`).

    Source: Spangenberg (2016), equations (1)-(6), without the division by the yaw rate.
    """
    count = len(poses)
    # the rear axle carries the arc; the front axle is put back once, at the end
    moved = move_reference_point(poses, -wheelbase_m)
    yaw = moved[:, 2]
    along, beside, turning = factors
    for arc in arcs:
        speed_sd, yaw_rate_sd, turn_sd = noise_of_arc(arc, config)
        noise = rng.standard_normal((4, count))
        distance = (arc.speed_mps + along * speed_sd * noise[0]) * arc.dt_s
        turn = arc.dt_s * (arc.yaw_rate_radps + turning * yaw_rate_sd * noise[1])
        sideslip = -slip_rad_per_mps2 * (arc.speed_mps * arc.yaw_rate_radps)
        left = (
            beside
            * config.alpha5_slip_m_per_sqrt_m
            * np.sqrt(abs(arc.speed_mps) * arc.dt_s)
            * noise[3]
        )
        moved[:, :2] += arc_displacement(yaw, distance, turn, sideslip, left)
        half = 0.5 * turn
        moved[:, 2] = yaw + half + half + turning * turn_sd * noise[2]
    return move_reference_point(moved, wheelbase_m)


def noise_of_arc(arc: Arc, config: LocalizeConfig) -> tuple[float, float, float]:
    """Standard deviations of speed, yaw rate and additional turn for one arc.

    The variance of distance and turn grows with time, not with the number of arcs: rates are
    scaled by sqrt(20 ms / dt), the turn by sqrt(dt / 20 ms).
    """
    rate_scale = np.sqrt(REFERENCE_STEP_S / arc.dt_s)
    speed_sd = np.hypot(config.alpha1_speed_mps, config.alpha1_relative * arc.speed_mps)
    yaw_rate_sd = config.alpha2_yaw_rate_radps
    turn_sd = min(config.alpha3_rotation_s * abs(arc.yaw_rate_radps), config.alpha4_rotation_rad)
    if arc.speed_mps == 0.0:
        speed_sd = yaw_rate_sd = 0.0
    speed_sd *= rate_scale
    if arc.blind_s > 0.0:
        # nothing was measured: the speed may have become anything within that
        speed_sd = np.hypot(speed_sd, _GAP_SPEED_MPS * np.sqrt(arc.blind_s / arc.dt_s))
    return float(speed_sd), float(yaw_rate_sd * rate_scale), float(turn_sd / rate_scale)
