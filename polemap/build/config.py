"""Settings of map building and updates."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class MappingConfig(BaseModel):
    """From detections and reference poses to a map."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    reference_sd_m: float = Field(
        0.05,
        gt=0.0,
        description="Standard deviation an axis of reference poses that state none.",
    )
    reference_yaw_sd_rad: float = Field(
        0.003,
        ge=0.0,
        description="Standard deviation of the reference's yaw, shared by a traversal.",
    )
    range_max_m: float = Field(60.0, gt=0.0, description="Detections farther away are left out.")
    merge_max_m: float = Field(0.8, gt=0.0, description="Traversals farther apart are two poles.")
    observations_min: int = Field(8, ge=1, description="A pole detected less often is not mapped.")
    existence_min: float = Field(
        0.5, ge=0.0, le=1.0, description="Least probability to stay in the map."
    )
    group_stakes: bool = Field(
        False, description="The stakes round a sapling (three or more) are mapped as one pole."
    )
    align_max_m: float = Field(3.0, gt=0.0, description="Greatest shift between drives.")
    drift_sd_m: float = Field(
        0.7, gt=0.0, description="Of a reference that drifts, an axis (with --align)."
    )
