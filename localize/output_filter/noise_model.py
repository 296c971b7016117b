"""What the output filter takes to be random: the car's motion, its odometry, the poses' floor."""

from __future__ import annotations

from dataclasses import dataclass

from polemap.vehicle.packed import CtrvNoise


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
        speed_scale_sd, speed_scale_walk: relative error of the speed, estimated; wander in 1 s.
        yaw_rate_offset_sd_radps, yaw_rate_offset_walk_radps: the same of the yaw rate's offset.
        pose_floor_m, pose_floor_rad: added to each pose's own standard deviations.
    """

    acceleration_mps2: float = 1.5
    acceleration_time_s: float = 0.5
    yaw_acceleration_radps2: float = 0.5
    yaw_acceleration_time_s: float = 0.3
    slip_rad_per_mps2: float = 0.004
    slip_time_s: float = 0.5
    speed_error_share: float = 0.015
    yaw_rate_error_radps: float = 0.004
    odometry_error_time_s: float = 0.5
    speed_scale_sd: float = 0.03
    speed_scale_walk: float = 0.001
    yaw_rate_offset_sd_radps: float = 0.005
    yaw_rate_offset_walk_radps: float = 0.0003
    pose_floor_m: float = 0.03
    pose_floor_rad: float = 0.003

    @property
    def densities(self) -> CtrvNoise:
        """Densities of the process noise."""
        return CtrvNoise(
            2.0 * self.acceleration_mps2**2 * self.acceleration_time_s,
            2.0 * self.yaw_acceleration_radps2**2 * self.yaw_acceleration_time_s,
            2.0 * self.slip_rad_per_mps2**2 * self.slip_time_s,
            2.0 * self.speed_error_share**2 * self.odometry_error_time_s,
            2.0 * self.yaw_rate_error_radps**2 * self.odometry_error_time_s,
            self.speed_scale_walk**2,
            self.yaw_rate_offset_walk_radps**2,
        )
