"""Settings of the localizer."""

from __future__ import annotations

from math import pi
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from polemap.localize.output_filter.config import OutputConfig


class LocalizeConfig(BaseModel):
    """Every setting of the particle filter; the names of the paper where it has one.

    The noise figures `alpha1 ... alpha4` are standard deviations for one odometry step of 20 ms,
    the paper's 50 Hz; for other steps they are scaled so that the spread per second stays.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    output: OutputConfig = OutputConfig()

    # particles
    particles: int = Field(1000, ge=10, le=100_000)
    threads: int = Field(1, ge=1, le=64)
    kld_adaptive: bool = False
    kld_particles_min: int = Field(50, ge=10)
    kld_particles_max: int = Field(2000, ge=10)
    kld_error: float = Field(0.05, gt=0, lt=1)
    kld_quantile: float = Field(2.33, gt=0, lt=6)
    kld_bin_m: float = Field(0.25, gt=0)
    kld_bin_rad: float = Field(0.05, gt=0)
    resample_below: float = Field(0.5, gt=0, le=1)

    # motion noise
    alpha1_speed_mps: float = Field(0.2, ge=0)
    alpha1_relative: float = Field(0.07, ge=0)
    alpha2_yaw_rate_radps: float = Field(0.03, ge=0)
    alpha3_rotation_s: float = Field(0.01, ge=0)
    alpha4_rotation_rad: float = Field(0.003, ge=0)
    alpha5_slip_m_per_sqrt_m: float = Field(0.015, ge=0)
    learn_noise: bool = True
    # factors on the standard deviations that the alphas give, see noise_scale.py
    noise_scale_start: float = Field(0.8, gt=0)
    noise_prior_windows: float = Field(2.0, gt=0)  # the start counts as if seen in so many windows
    noise_memory_windows: float = Field(30.0, gt=1)  # after so many, a window counts a third
    noise_window: float = Field(8.0, gt=0)  # length in independent scans, not in scans or seconds
    noise_scale_min: float = Field(0.2, gt=0, le=1)
    noise_scale_max: float = Field(4.0, ge=1)
    arc_s: float = Field(0.06, gt=0, le=1)
    odometry_gap_s: float = Field(0.5, gt=0)
    gap_speed_mps: float = Field(2.0, ge=0)

    # odometry calibration
    learn_offsets: bool = True
    standstill_speed_mps: float = Field(0.03, gt=0)
    standstill_s: float = Field(1.0, gt=0)
    yaw_rate_offset_sd_radps: float = Field(0.005, ge=0)
    curvature_offset_sd_radpm: float = Field(0.0015, ge=0)
    yaw_rate_scale_sd: float = Field(0.03, ge=0)
    speed_scale_sd: float = Field(0.02, ge=0)
    # rear-axle slip per lateral acceleration, m l_f / (l C_r): by vehicle/cars 0.0052 for a RAV4,
    # 0.0057 for the identified 250 LM, 0.0076 for a Passat
    slip_rad_per_mps2: float = Field(0.006, ge=0, le=0.05)
    slip_sd_rad_per_mps2: float = Field(0.0015, ge=0, le=0.05)

    # likelihood of a scan
    p_detection: float = Field(0.7, gt=0, lt=1)
    clutter_per_m2: float = Field(1e-3, gt=0)
    clutter_width_span_m: float = Field(1.0, gt=0)
    beta_p: float = Field(1.0, gt=0)
    width_sd_m: float = Field(0.15, gt=0)
    position_floor_m: float = Field(0.03, ge=0)
    correlation_m: float = Field(2.0, gt=0)
    correlation_s: float = Field(1.0, gt=0)
    min_effective_share: float = Field(0.03, ge=0, le=0.5)
    view_range_m: float = Field(25.0, gt=0)
    view_half_angle_rad: float = Field(pi / 3, gt=0, le=pi)

    # GNSS
    gnss_sd_m: float = Field(2.5, gt=0)
    gnss_correlation_s: float = Field(60.0, gt=0)
    gnss_outlier_share: float = Field(0.1, gt=0, lt=1)
    gnss_window_s: float = Field(30.0, gt=0)
    start_patience_s: float = Field(5.0, ge=0)
    start_particles_factor: int = Field(4, ge=1, le=100)
    gnss_max_age_s: float = Field(3.0, gt=0)

    # exploration and recovery
    likelihood_short_s: float = Field(1.0, gt=0)
    likelihood_long_s: float = Field(20.0, gt=0)
    explore_margin: float = Field(0.4, gt=0, le=1)
    explore_share_max: float = Field(0.2, ge=0, le=0.9)
    constellation_min_poles: int = Field(3, ge=2)
    constellation_interval_s: float = Field(0.5, ge=0)
    constellation_tolerance_m: float = Field(0.6, gt=0)
    constellation_reach_m: float = Field(40.0, gt=0)
    lost_sd_m: float = Field(15.0, gt=0)
    lost_match_share: float = Field(0.34, ge=0, le=1)
    lost_gnss_sd: float = Field(5.0, gt=0)
    lost_after_s: float = Field(3.0, gt=0)

    # estimate and health
    estimate: Literal["mean", "best_mode"] = "best_mode"
    mode_radius_m: float = Field(1.5, gt=0)
    mode_radius_rad: float = Field(0.35, gt=0)
    mode_share_min: float = Field(0.1, gt=0, lt=1)
    healthy_sd_m: float = Field(2.0, gt=0)
    proven_sd_m: float = Field(0.5, gt=0)
    proven_after_m: float = Field(25.0, gt=0)

    @model_validator(mode="after")
    def _ordered(self) -> LocalizeConfig:
        if self.kld_particles_min > self.kld_particles_max:
            raise ValueError(
                f"kld_particles_min {self.kld_particles_min} is above kld_particles_max "
                f"{self.kld_particles_max}"
            )
        if self.likelihood_long_s <= self.likelihood_short_s:
            raise ValueError(
                f"likelihood_long_s {self.likelihood_long_s} must be above likelihood_short_s "
                f"{self.likelihood_short_s}"
            )
        return self
