"""Settings of the pole room: how poles are detected, tracked and mapped."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class DetectionConfig(BaseModel):
    """From a disparity pair to classified pole hypotheses.

    Lengths are metric wherever possible, so that one set of values serves every camera.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    model: str = Field("default", description="Built-in classifier name, or a path to its JSON.")
    row_step_px: int = Field(2, ge=1, le=8, description="Every n-th image row is looked at.")
    range_min_m: float = Field(3.0, gt=0.0)
    range_max_m: float = Field(28.0, gt=0.0, le=100.0)
    step_min_px: float = Field(0.8, gt=0.0, description="Smallest disparity jump of a depth edge.")
    step_min_m: float = Field(0.4, gt=0.0, description="Smallest depth jump of a depth edge.")
    width_min_m: float = Field(0.03, gt=0.0)
    width_max_m: float = Field(0.9, gt=0.0)
    lean_max_rad: float = Field(0.18, gt=0.0, le=0.5)
    height_min_m: float = Field(0.35, gt=0.0, description="Least upright extent with edges.")
    base_max_m: float = Field(2.2, gt=0.0, description="Greatest height of the lowest evidence.")
    hypotheses_max: int = Field(80, ge=1, le=1000)
    probability_min: float = Field(0.5, ge=0.0, le=1.0, description="Least to be a detection.")


class TrackingConfig(BaseModel):
    """Constant landmarks in the vehicle frame, moved by odometry."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    output: Literal["detections", "tracks"] = "detections"


class PolemapConfig(BaseModel):
    """Settings of the pole room."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    detection: DetectionConfig = DetectionConfig()
    tracking: TrackingConfig = TrackingConfig()
