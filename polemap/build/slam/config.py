"""Settings of map building without reference poses."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class SlamConfig(BaseModel):
    """From odometry, detected poles and GNSS to poses (`polemap map --slam`)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    keyframe_m: float = Field(
        2.0, gt=0.05, le=20.0, description="Way between the poses that are solved for."
    )
    submap_m: float = Field(
        30.0, gt=2.0, le=500.0, description="Way of one local map of poles, matched as a whole."
    )
    rounds_max: int = Field(
        8, ge=1, le=50, description="Most rounds of association and solving to a fixed point."
    )
    speed_scale_sd: float = Field(
        0.05, gt=0.0, le=0.5, description="Relative error of the speed before it is solved for, sd."
    )
    yaw_rate_scale_sd: float = Field(0.05, gt=0.0, le=0.5, description="The same of the yaw rate.")
    yaw_rate_offset_sd_radps: float = Field(
        0.005, gt=0.0, le=0.1, description="Offset of the yaw rate, sd, rad/s."
    )
    curvature_offset_sd_radpm: float = Field(
        0.002, gt=0.0, le=0.1, description="Offset of the steering, sd, as curvature in rad/m."
    )
    sideslip_sd_rad: float = Field(
        0.02, gt=0.0, le=0.5, description="Yaw of the detector to the way of the car, sd, rad."
    )
    slip_sd_rad_per_mps2: float = Field(
        0.004, gt=0.0, le=0.1, description="Outward slip of the rear axle, sd, rad per m/s^2."
    )
    calibration_s: float = Field(
        120.0, gt=1.0, description="Time in which the odometry's calibration stays the same."
    )
    calibration_walk: float = Field(
        0.1,
        gt=0.0,
        le=10.0,
        description="Change of the calibration from one such time to the next, in its own sd.",
    )
    gnss_sd_m: float = Field(
        2.5, gt=0.0, le=1000.0, description="Standard deviation of a fix at HDOP 1, an axis."
    )
    gnss_white_m: float = Field(
        0.5, gt=0.0, le=1000.0, description="Part of it that does not last from fix to fix, HDOP 1."
    )
    gnss_correlation_s: float = Field(
        60.0, gt=0.1, le=3600.0, description="Time over which the rest of it wanders."
    )
    pole_floor_m: float = Field(
        0.05, gt=0.0, le=2.0, description="Least error of a detection, sd an axis."
    )
    same_pole_sd_m: float = Field(
        0.06, gt=0.0, le=2.0, description="Two passes see the middle of one trunk so far apart, sd."
    )
    loop_log_odds: float = Field(8.0, gt=0.0, description="Least log odds of a loop against none.")
    loop_margin: float = Field(
        5.0, gt=0.0, description="And against every other place within reach."
    )
