"""Settings of the tracker: how poles of single frames become tracks."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


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
        0.3, ge=0.0, description="Correlation time of a pole's position error."
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
