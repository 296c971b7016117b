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
    birth_probability: float = Field(0.3, ge=0.0, le=1.0, description="Least to begin a track.")
    confirm_existence: float = Field(
        0.85, gt=0.0, lt=1.0, description="Least probability of existence to confirm a track."
    )
    confirm_hits: int = Field(2, ge=1, description="Least frames that detected it to confirm it.")
    forget_after_s: float = Field(3.0, gt=0.0, description="Without a detection a track ends.")
    speed_sd_share: float = Field(
        0.02, ge=0.0, description="Standard deviation of odometry, in lengths of the way."
    )
    yaw_rate_sd_radps: float = Field(
        0.01, ge=0.0, description="Standard deviation of the odometry's yaw rate."
    )
    group_stakes: bool = Field(
        False,
        description="Scans hold the stakes round a sapling (three or more) as one pole.",
    )
    disparity_offset_sd_px: float = Field(
        0.4, ge=0.0, description="Error that all disparities may share; learned, 0 switches it off."
    )
