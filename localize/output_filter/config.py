"""Settings of the output filter, its gate and its limits."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class OutputConfig(BaseModel):
    """The 100 Hz pose: CTRV EKF, gate, health policy, clocks.

    Densities follow from what a car can do: an acceleration of standard deviation s that lasts
    for a time t acts on a slow filter like white noise of density 2 s^2 t.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    rate_hz: int = Field(100, ge=1, le=1000, description="Output rate; ticks are k / rate.")
    processing_delay_s: float = Field(
        0.08,
        ge=0.0,
        le=1.0,
        description="Replay: from the arrival of a frame to its particle-filter pose.",
    )
    horizon_s: float = Field(1.0, gt=0.0, le=10.0, description="How late an input may be.")

    # motion
    acceleration_mps2: float = Field(1.5, gt=0.0, description="Longitudinal, standard deviation.")
    acceleration_time_s: float = Field(0.5, gt=0.0)
    yaw_acceleration_radps2: float = Field(0.5, gt=0.0)
    yaw_acceleration_time_s: float = Field(0.3, gt=0.0)
    slip_rad_per_mps2: float = Field(
        0.004, ge=0.0, description="Side-slip of the rear axle, which CTRV lacks."
    )
    slip_time_s: float = Field(0.5, gt=0.0)

    # odometry
    speed_sd_mps: float = Field(0.05, gt=0.0)
    speed_sd_share: float = Field(0.0, ge=0.0, description="Added to it, of the speed.")
    yaw_rate_sd_radps: float = Field(0.003, gt=0.0)
    speed_error_share: float = Field(
        0.015, ge=0.0, description="Error that lasts: of the speed, standard deviation."
    )
    yaw_rate_error_radps: float = Field(0.004, ge=0.0, description="The same of the yaw rate.")
    odometry_error_time_s: float = Field(0.5, gt=0.0, description="How long such errors last.")
    speed_scale_sd: float = Field(0.03, ge=0.0, description="Relative error, estimated.")
    speed_scale_walk: float = Field(0.001, ge=0.0, description="Its wander in 1 s.")
    yaw_rate_offset_sd_radps: float = Field(0.005, ge=0.0, description="Estimated.")
    yaw_rate_offset_walk_radps: float = Field(0.0003, ge=0.0, description="Its wander in 1 s.")
    odometry_gate: float = Field(0.9999, gt=0.0, lt=1.0)
    odometry_rejections_max: int = Field(10, ge=1, description="In a row; then it is believed.")
    standstill_mps: float = Field(0.02, ge=0.0, description="Slower than this the car stands.")

    # particle-filter poses
    pose_gate: float = Field(0.999, gt=0.0, lt=1.0)
    gate: bool = Field(True, description="Off: every pose is taken in.")
    pose_floor_m: float = Field(0.03, ge=0.0, description="Added to each pose's own sd.")
    pose_floor_rad: float = Field(0.003, ge=0.0)
    pose_errors: Literal["shared", "independent"] = Field(
        "shared",
        description="Shared: successive poses err alike, and the output never claims to know more "
        "than the pose that it was given. Independent: each pose is news, as a plain EKF has it.",
    )
    pose_follow_s: float = Field(
        0.3, gt=0.0, description="Time in which the output follows shared poses at least."
    )
    offer_sd_max_m: float = Field(
        5.0, gt=0.0, description="A pose with a larger major position sd is not offered."
    )
    offer_modes_max: int = Field(1, ge=1)
    offer_match_min: float = Field(
        0.0, ge=0.0, le=1.0, description="Least share of the seen poles that the map explains."
    )

    # consecutive rejections: ignore, then inflate, then re-initialize
    inflate_after_s: float = Field(0.5, ge=0.0)
    inflate_factor: float = Field(1.3, gt=1.0, description="On the pose's sd, per rejection.")
    inflate_max_m: float = Field(0.5, gt=0.0)
    inflate_max_rad: float = Field(0.015, gt=0.0)
    reinitialize_after_s: float = Field(2.0, gt=0.0)
    gnss_veto: float = Field(
        1.0, description="Log-likelihood by which GNSS must speak for the filter to veto it."
    )

    # GNSS: starts the filter and bounds it while no pose is accepted
    gnss_sd_m: float = Field(2.5, gt=0.0, description="At a HDOP of 1.")
    gnss_correlation_s: float = Field(60.0, ge=0.0)
    gnss_after_s: float = Field(5.0, ge=0.0, description="Without an accepted pose.")
    gnss_gate: float = Field(0.99, gt=0.0, lt=1.0)
    gnss_restart_after_s: float = Field(
        5.0, gt=0.0, description="Of rejected fixes, without an accepted pose: start anew."
    )
    start_yaw_sd_rad: float = Field(0.3, gt=0.0, description="Heading known well enough to start.")

    # the output's own limits
    correction_mps: float = Field(1.5, gt=0.0, description="Fastest correction of the position.")
    correction_radps: float = Field(0.4, gt=0.0)

    # clocks
    future_s: float = Field(0.05, ge=0.0, description="A stamp may lie this far behind arrival.")
    clock_step_s: float = Field(0.5, gt=0.0, description="A step of a clock, when it stays.")
    clock_step_samples: int = Field(5, ge=2, description="Samples that must agree on a step.")
    silence_s: float = Field(0.5, gt=0.0, description="A sensor silent for longer has stopped.")
