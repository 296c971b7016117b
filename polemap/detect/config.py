"""Settings of the detector: how a stereo frame becomes poles."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


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
        0.15,
        gt=0.0,
        description="Error that a whole candidate shares, beside what all poles share.",
    )
    matcher_sd_px: float = Field(0.25, ge=0.0, description="More of it without the fit.")
    column_sd_px: float = Field(0.7, gt=0.0, description="Error of a candidate's centre column.")
    across_sd_m: float = Field(0.03, ge=0.0, description="Of the axis at ground level, sideways.")
    across_sd_share: float = Field(0.1, ge=0.0, le=1.0, description="More of it, in widths.")
    extension_sd_m: float = Field(
        0.05, ge=0.0, description="More of it, for each length by which the axis is extended down."
    )
    axis_share: float = Field(0.3, ge=0.0, le=1.0, description="Axis behind surface, in widths.")
    axis_sd_share: float = Field(0.15, ge=0.0, le=1.0)
