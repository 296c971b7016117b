"""What the output filter takes to be random: the car's motion, its odometry, the poses' floor."""

from __future__ import annotations

from dataclasses import dataclass

from polemap.vehicle.packed import CtrvNoise, GaussMarkov

# a correlation time of zero is white noise: shorter than any interval between fixes
_LEAST_TIME_S = 1e-3


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Standard deviations, and how long what they describe lasts.

    Densities follow from what a car can do: an acceleration of standard deviation s that lasts
    for a time t acts on a slow filter like white noise of density 2 s^2 t.

    The figures are what passenger cars do in town (accelerations, slip of the rear axle that the
    learned one leaves), and what wheel odometry gets wrong (the rest); the output is consistent
    with them on simulated drives and on Victoria Park, see docs/output_filter.md.

    Attributes:
        acceleration_mps2, acceleration_time_s: along the car.
        yaw_acceleration_radps2, yaw_acceleration_time_s: of its turn.
        slip_rad_per_mps2, slip_time_s: side-slip of the rear axle, which CTRV lacks.
        speed_error_share, yaw_rate_error_radps, odometry_error_time_s: errors that last.
        turn_error_share, turn_error_time_s: the same of the yaw rate, in proportion to it.
        speed_scale_sd, yaw_rate_offset_sd_radps: relative error of the speed and offset of the
            yaw rate, estimated; they wander within these, so that no row of bad fixes can lead
            them away.
        odometry_drift_s: time in which both forget.
        pose_floor_m, pose_floor_rad: added to each pose's own standard deviations.
    """

    acceleration_mps2: float = 1.5
    acceleration_time_s: float = 0.5
    yaw_acceleration_radps2: float = 0.5
    yaw_acceleration_time_s: float = 0.3
    slip_rad_per_mps2: float = 0.004
    slip_time_s: float = 0.5
    speed_error_share: float = 0.01
    yaw_rate_error_radps: float = 0.002
    odometry_error_time_s: float = 0.5
    turn_error_share: float = 0.01
    turn_error_time_s: float = 2.0
    speed_scale_sd: float = 0.03
    yaw_rate_offset_sd_radps: float = 0.005
    odometry_drift_s: float = 14400.0
    pose_floor_m: float = 0.03
    pose_floor_rad: float = 0.003

    def densities(self, fix_sd_m: float, fix_time_s: float) -> CtrvNoise:
        """Densities of the process noise.

        Args:
            fix_sd_m, fix_time_s: of the error that fixes share.
        """
        return CtrvNoise(
            2.0 * self.acceleration_mps2**2 * self.acceleration_time_s,
            2.0 * self.yaw_acceleration_radps2**2 * self.yaw_acceleration_time_s,
            2.0 * self.slip_rad_per_mps2**2 * self.slip_time_s,
            2.0 * self.speed_error_share**2 * self.odometry_error_time_s,
            2.0 * self.yaw_rate_error_radps**2 * self.odometry_error_time_s,
            2.0 * self.turn_error_share**2 * self.turn_error_time_s,
            GaussMarkov(self.speed_scale_sd, self.odometry_drift_s),
            GaussMarkov(self.yaw_rate_offset_sd_radps, self.odometry_drift_s),
            GaussMarkov(fix_sd_m, max(fix_time_s, _LEAST_TIME_S)),
        )
