"""Sampling the motion of the particles with the noise alpha 1 to alpha 4 of the paper."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from polemap.extras import kernel
from polemap.localize.config import LocalizeConfig
from polemap.localize.odometry_history import Arc
from polemap.localize.particle_filter.free_motion import FreeMotion
from polemap.localize.particle_filter.odometry_faults import OdometryFaults
from polemap.vehicle.motion import arc_displacement
from polemap.vehicle.pose import move_reference_point

Floats = NDArray[np.float64]

# the step that the alphas are given for: odometry at 50 Hz
REFERENCE_STEP_S = 0.02
# a turn as tight as a car park's, where tyres and steering gear leave their linear range
_TIGHT_RADPM = 0.2


def sample_motion(
    poses: Floats,
    arcs: Iterable[Arc],
    wheelbase_m: float,
    config: LocalizeConfig,
    rng: np.random.Generator,
    slip_rad_per_mps2: Floats | float = 0.0,
    factors: Floats | tuple[float, float, float] = (1.0, 1.0, 1.0),
    motion: FreeMotion | None = None,
    faults: OdometryFaults | None = None,
    rear: Floats | None = None,
) -> Floats:
    """Front-axle poses `(n, 3)` after the arcs, each particle with its own noise; yaw not wrapped.

    On every arc, speed and yaw rate get zero-mean noise of standard deviation alpha1 and alpha2,
    and the heading an additional turn of standard deviation min(alpha3 |yaw rate|, alpha4), without
    which three dimensions could not be sampled. A standing car does not move: the noise of an arc
    without speed and yaw rate is zero.

    The rear axle does not go where the car points: in a bend its tyres slip outward, which the
    paper leaves out. On an arc of lateral acceleration a it goes in the direction yaw - k a, with
    `slip_rad_per_mps2` k of every particle, `(n,)`.

    With `motion` the particles that are free move by rates of their own; without it those that
    `faults` says hold the odometry for wrong correct it by what they take its errors for.

    `rear` are the poses of the rear axle `(n, 3)`, where they are known.

    `factors` scale the noise along, aside and of the turn (`NoiseScale`).

    Source: Spangenberg (2016), equations (1)-(6), without the division by the yaw rate.
    """
    count = len(poses)
    # the rear axle carries the arc; the front axle is put back once, at the end
    moved = move_reference_point(poses, -wheelbase_m) if rear is None else rear.copy()
    along, beside, turning = factors
    slips = np.broadcast_to(np.asarray(slip_rad_per_mps2, dtype=np.float64), count)
    sound = np.zeros(count)
    native = (
        kernel("polemap.localize.particle_filter.native.particle_kernel")
        if motion is None
        else None
    )
    for arc in arcs:
        speed_sd, yaw_rate_sd, turn_sd = noise_of_arc(arc, config)
        noise = rng.standard_normal((4, count))
        # the error of tight turns is not learned where the road is straight
        turn_sd = float(np.hypot(turning * turn_sd, tight_turn_sd(arc, config)))
        left_sd = beside * config.alpha5_slip_m_per_sqrt_m * np.sqrt(abs(arc.speed_mps) * arc.dt_s)
        if native is not None:
            wrong = faults is not None and arc.speed_mps != 0.0
            moved = native.move_along_arc(
                moved, noise, slips,
                faults.speed_share if faults is not None and wrong else sound,
                faults.rate_radps if faults is not None and wrong else sound,
                arc.dt_s, arc.speed_mps, arc.yaw_rate_radps,
                along * speed_sd, turning * yaw_rate_sd, turn_sd, left_sd,
            )  # fmt: skip
            continue
        speed: Floats = arc.speed_mps + along * speed_sd * noise[0]
        rate: Floats = arc.yaw_rate_radps + turning * yaw_rate_sd * noise[1]
        if motion is not None:
            motion.step(arc.dt_s)
            speed += motion.followed_mps - arc.speed_mps
            speed = np.where(motion.free, motion.speed_mps, speed)
            rate = np.where(motion.free, motion.yaw_rates(arc.yaw_rate_radps), rate)
        elif faults is not None and arc.speed_mps != 0.0:
            speed += faults.speed_share * arc.speed_mps
            rate += faults.rate_radps
        distance = speed * arc.dt_s
        turn = arc.dt_s * rate
        sideslip = -slips * (arc.speed_mps * arc.yaw_rate_radps)
        yaw = moved[:, 2]
        moved[:, :2] += arc_displacement(yaw, distance, turn, sideslip, left_sd * noise[3])
        half = 0.5 * turn
        moved[:, 2] = yaw + half + half + turn_sd * noise[2]
    return move_reference_point(moved, wheelbase_m)


def tight_turn_sd(arc: Arc, config: LocalizeConfig) -> float:
    """Standard deviation of the additional turn of an arc where it is as tight as in a car park.

    A yaw rate from steering or wheels that is off by a share s through a turn of some seconds T
    acts like white noise of density 2 (s w)^2 T: with alpha3 of 10 ms, s is 5 % for 2 s. It grows
    with the curvature, has no bound as alpha4, and is not scaled by what was learned elsewhere.
    """
    if arc.yaw_rate_radps == 0.0 or arc.speed_mps == 0.0:
        return 0.0
    tight = min(1.0, abs(arc.yaw_rate_radps / arc.speed_mps) / _TIGHT_RADPM)
    alpha3 = config.tight_turn_factor * config.alpha3_rotation_s
    return float(tight * alpha3 * abs(arc.yaw_rate_radps) * np.sqrt(arc.dt_s / REFERENCE_STEP_S))


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
    return float(speed_sd), float(yaw_rate_sd * rate_scale), float(turn_sd / rate_scale)
