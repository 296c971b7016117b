"""Settings of the pole room: how poles are detected, tracked and mapped."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from polemap.mapping_config import MappingConfig


class DetectionConfig(BaseModel):
    """From a disparity pair to classified pole hypotheses.

    Lengths are metric wherever possible, so that one set of values serves every camera.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    model: str = Field("default", description="Built-in classifier name, or a path to its JSON.")
    row_step_px: int = Field(3, ge=1, le=8, description="Every n-th image row is looked at.")
    range_min_m: float = Field(3.0, gt=0.0)
    range_max_m: float = Field(30.0, gt=0.0, le=100.0)
    step_min_px: float = Field(0.8, gt=0.0, description="Smallest disparity jump of a depth edge.")
    step_min_m: float = Field(0.4, gt=0.0, description="Smallest depth jump of a depth edge.")
    width_min_m: float = Field(0.03, gt=0.0)
    width_max_m: float = Field(1.1, gt=0.0)
    lean_max_rad: float = Field(0.18, gt=0.0, le=0.5)
    height_min_m: float = Field(0.35, gt=0.0, description="Least upright extent with edges.")
    base_max_m: float = Field(2.2, gt=0.0, description="Greatest height of the lowest evidence.")
    hypotheses_max: int = Field(80, ge=1, le=1000)
    probability_min: float = Field(0.5, ge=0.0, le=1.0, description="Least to be a detection.")
    refine_probability: float = Field(
        0.15, ge=0.0, le=1.0, description="From here on the disparity is fitted to the images."
    )
    disparity_sd_px: float = Field(
        0.15, gt=0.0, description="Error that a whole stem shares, beside what all poles share."
    )
    matcher_sd_px: float = Field(0.25, ge=0.0, description="More of it without the fit.")
    column_sd_px: float = Field(0.7, gt=0.0, description="Error of a stem's centre column.")
    across_sd_m: float = Field(0.03, ge=0.0, description="Of the axis at ground level, sideways.")
    across_sd_share: float = Field(0.1, ge=0.0, le=1.0, description="More of it, in widths.")
    extension_sd_m: float = Field(
        0.05, ge=0.0, description="More of it, for each length by which the axis is extended down."
    )
    axis_share: float = Field(0.3, ge=0.0, le=1.0, description="Axis behind surface, in widths.")
    axis_sd_share: float = Field(0.15, ge=0.0, le=1.0)


class TrackingConfig(BaseModel):
    """Constant landmarks in the vehicle frame, moved by odometry."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    output: Literal["detections", "tracks"] = Field(
        "detections",
        description="A scan holds this frame's detections of confirmed tracks, or filtered tracks.",
    )
    probability_min: float = Field(
        0.2, ge=0.0, le=1.0, description="Least for a detection to continue a track."
    )
    gate_probability: float = Field(0.99, gt=0.0, lt=1.0, description="Mass of the gate's ellipse.")
    width_sd_m: float = Field(0.12, gt=0.0, description="Of one width measurement.")
    detection_probability: float = Field(
        0.5, gt=0.0, lt=1.0, description="In view, per frame, of thin and far ones, too."
    )
    pole_share: float = Field(
        0.43, gt=0.0, lt=1.0, description="Of what a detector judges: its odds speak against these."
    )
    birth_probability: float = Field(0.3, ge=0.0, le=1.0, description="Least to begin a track.")
    gate_max_m: float = Field(2.5, gt=0.0, description="Of the gate, whatever the covariance.")
    period_s: float = Field(0.1, gt=0.0, description="Frames closer than this are less evidence.")
    error_time_s: float = Field(
        0.3, ge=0.0, description="Correlation time of a stem's position error."
    )
    confirm_existence: float = Field(0.85, gt=0.0, lt=1.0)
    confirm_hits: int = Field(2, ge=1)
    delete_existence: float = Field(0.05, gt=0.0, lt=1.0)
    forget_after_s: float = Field(3.0, gt=0.0, description="Not seen, not expected: dropped.")
    speed_sd_share: float = Field(0.02, ge=0.0, description="Odometry noise in the prediction.")
    speed_sd_mps: float = Field(0.1, ge=0.0)
    yaw_rate_sd_radps: float = Field(0.01, ge=0.0)
    drift_sd_mps: float = Field(0.05, ge=0.0, description="How fast a landmark may wander.")
    disparity_offset_sd_px: float = Field(
        0.4, ge=0.0, description="Error that all disparities may share; learned, 0 switches it off."
    )
    gap_max_s: float = Field(1.0, gt=0.0, description="A longer gap in odometry drops all tracks.")


class PolemapConfig(BaseModel):
    """Settings of the pole room."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    detection: DetectionConfig = DetectionConfig()
    tracking: TrackingConfig = TrackingConfig()
    mapping: MappingConfig = MappingConfig()
