"""Settings of the estimators, one model for the room."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class EstimatorConfig(BaseModel):
    """Noise and timing that the estimators assume.

    Process noise is given as the square root of its spectral density: a `walk` of s means that
    the quantity wanders by s after one second, by s sqrt(t) after t.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    step_s: float = Field(0.001, gt=0.0, le=0.1, description="nominal step of the fast signals")
    sideslip_walk_rad: float = Field(0.0316, gt=0.0, le=1.0, description="model error of beta'")
    yaw_rate_walk_radps: float = Field(0.316, gt=0.0, le=10.0, description="model error of gamma'")
    gyro_sd_radps: float = Field(0.003, gt=0.0, le=1.0)
    heading_sd_rad: float = Field(0.002, gt=0.0, le=1.0, description="camera")
    lateral_offset_sd_m: float = Field(0.005, gt=0.0, le=10.0, description="camera")
    camera_period_s: float = Field(0.033, gt=0.0, le=1.0)
    camera_delay_s: float = Field(
        0.033, ge=0.0, le=1.0, description="delay that filters assume which cannot read stamps"
    )
    camera_slots: int = Field(1, ge=1, le=8, description="frames that may be on their way at once")
    lateral_acceleration_sd_mps2: float = Field(0.1, gt=0.0, le=10.0)
    acceleration_walk_mps: float = Field(
        0.1, gt=0.0, le=10.0, description="accelerometer noise, integrated over one second"
    )
    observer_pole_radps: float = Field(10.0, gt=0.0, le=500.0, description="linear observer")
    course_sd_rad: float = Field(0.01, gt=0.0, le=1.0, description="GPS")
    speed_sd_mps: float = Field(0.05, gt=0.0, le=10.0, description="GPS speed")
    wheel_speed_sd_mps: float = Field(0.1, gt=0.0, le=10.0)
    heading_walk_rad: float = Field(
        0.0, ge=0.0, le=1.0, description="heading in 1 s beside the yaw rate: bias of a real gyro"
    )
    gps_slots: int = Field(1, ge=1, le=8)
    disturbance_time_s: float = Field(2.0, gt=0.01, le=1000.0, description="leak of d")
    sideslip_disturbance_radps: float = Field(0.1, gt=0.0, le=10.0, description="sd of d_beta")
    yaw_disturbance_radps2: float = Field(1.0, gt=0.0, le=100.0, description="sd of d_gamma")
    acceleration_disturbance_mps2: float = Field(0.3, gt=0.0, le=10.0, description="sd of bias")
    acceleration_disturbance_time_s: float = Field(20.0, gt=0.01, le=1e5)
    stiffness_walk: float = Field(0.01, gt=0.0, le=1.0, description="stiffness scale in 1 s")
    stiffness_sd: float = Field(0.3, gt=0.0, le=2.0, description="stiffness scale at the start")
    stiffness_model_scale: float = Field(
        0.25,
        gt=0.0,
        le=1.0,
        description="walks of the stiffness filter over the others': its scale carries the rest",
    )
    outage_s: float = Field(0.5, gt=0.0, le=100.0, description="silence that counts as a loss")
    bridge_time_s: float = Field(
        0.3, ge=0.0, le=10.0, description="time constant by which the output joins after a loss"
    )
    initial_sideslip_sd_rad: float = Field(0.02, gt=0.0, le=1.0)
    initial_yaw_rate_sd_radps: float = Field(0.1, gt=0.0, le=5.0)
    initial_heading_sd_rad: float = Field(0.1, gt=0.0, le=4.0)
    initial_offset_sd_m: float = Field(1.0, gt=0.0, le=100.0)
