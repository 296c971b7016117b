"""Settings of the estimators: what differs from car to car and from sensor to sensor.

What no user should turn stands beside the code that uses it, as a named constant with its source.
"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

# What an estimator holds of the start, one sigma: a car that may be in a bend (2 % side-slip, a
# tenth of a radian a second), on a lane whose direction a driver has within six degrees, anywhere
# across it. A camera or a course corrects all of it within its first values.
INITIAL_SIDESLIP_SD_RAD = 0.02
INITIAL_YAW_RATE_SD_RADPS = 0.1
INITIAL_HEADING_SD_RAD = 0.1
INITIAL_OFFSET_SD_M = 1.0


class EstimatorConfig(BaseModel):
    """Noise and timing that the estimators assume.

    Process noise is given as the square root of its spectral density: a `walk` of s means that
    the quantity wanders by s after one second, by s sqrt(t) after t.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    # timing
    step_s: float = Field(
        0.001, gt=0.0, le=0.1, description="Nominal step of the fast signals, seconds."
    )
    camera_period_s: float = Field(
        0.033,
        gt=0.0,
        le=1.0,
        description="From picture to picture, seconds; for filters that cannot read stamps.",
    )
    camera_delay_s: float = Field(
        0.033,
        ge=0.0,
        le=1.0,
        description="From the picture to its value, seconds; for filters that cannot read stamps.",
    )
    camera_slots: int = Field(
        1, ge=1, le=8, description="Pictures that may be on their way at once; a count."
    )
    gps_slots: int = Field(
        1, ge=1, le=8, description="GPS values that may be on their way at once; a count."
    )
    # model errors
    sideslip_walk_rad: float = Field(
        0.0316,
        gt=0.0,
        le=1.0,
        description="What the single-track model lacks in the side-slip after 1 s, radians.",
    )
    yaw_rate_walk_radps: float = Field(
        0.316,
        gt=0.0,
        le=10.0,
        description="What the single-track model lacks in the yaw rate after 1 s, rad/s.",
    )
    heading_walk_rad: float = Field(
        0.0,
        ge=0.0,
        le=1.0,
        description="What the heading wanders in 1 s beside the yaw rate, radians: a gyro's bias.",
    )
    lateral_offset_walk_m: float = Field(
        0.0,
        ge=0.0,
        le=10.0,
        description="What the lateral offset wanders in 1 s beside its geometry, metres; with "
        "heading_walk_rad the vision part of the process noise.",
    )
    sideslip_disturbance_radps: float = Field(
        0.1,
        gt=0.0,
        le=10.0,
        description="Standard deviation of the unknown rate of the side-slip, rad/s (two_layer).",
    )
    yaw_disturbance_radps2: float = Field(
        1.0,
        gt=0.0,
        le=100.0,
        description="Standard deviation of the unknown yaw acceleration, rad/s^2 (two_layer).",
    )
    # sensors
    innovation_gate_sd: float = Field(
        5.0,
        ge=0.0,
        le=100.0,
        description="A value whose residual is beyond so many predicted deviations is left out; "
        "0 takes every value, as the papers' filters are printed.",
    )
    isolate_faults: bool = Field(
        True,
        description="Whether `estimate` tells which sensor is faulty by votes of all of them and "
        "goes on without it; a yes or no.",
    )
    gyro_sd_radps: float = Field(
        0.003, gt=0.0, le=1.0, description="Standard deviation of the yaw rate, rad/s."
    )
    acceleration_walk_mps: float = Field(
        0.1, gt=0.0, le=10.0, description="Accelerometer noise integrated over 1 s, m/s."
    )
    acceleration_disturbance_time_s: float = Field(
        20.0,
        gt=0.01,
        le=1e5,
        description="How long the accelerometer keeps its bias, seconds; where roll makes it, as "
        "long as a bend.",
    )
    heading_sd_rad: float = Field(
        0.002,
        gt=0.0,
        le=1.0,
        description="Standard deviation of the camera's heading in the lane, radians.",
    )
    lateral_offset_sd_m: float = Field(
        0.005,
        gt=0.0,
        le=10.0,
        description="Standard deviation of the camera's lateral offset, metres.",
    )
    curvature_sd_per_m: float = Field(
        0.0005,
        gt=0.0,
        le=0.1,
        description="Standard deviation of the camera's road curvature, 1/m; where a log has it.",
    )
    course_sd_rad: float = Field(
        0.01, gt=0.0, le=1.0, description="Standard deviation of the GPS course, radians."
    )
    speed_sd_mps: float = Field(
        0.05, gt=0.0, le=10.0, description="Standard deviation of the GPS speed, m/s."
    )
