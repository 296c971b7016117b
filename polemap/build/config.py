"""Settings of map building and updates."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class MappingConfig(BaseModel):
    """From detections and reference poses to a map."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    reference_sd_m: float = Field(
        0.05, gt=0.0, description="Of reference poses that state none, an axis."
    )
    reference_yaw_sd_rad: float = Field(0.003, ge=0.0, description="Shared by a traversal.")
    systematic_sd_m: float = Field(
        0.02, ge=0.0, description="Error of a detector that no repetition averages away."
    )
    disparity_pass_sd_px: float = Field(
        0.22,
        ge=0.0,
        description="Disparity error of a pole that one traversal shares (stereo only).",
    )
    disparity_common_sd_px: float = Field(
        0.2,
        ge=0.0,
        description="Disparity error that all traversals of all drives share (calibration).",
    )
    range_max_m: float = Field(60.0, gt=0.0, description="Detections farther away are left out.")
    gate_probability: float = Field(0.997, gt=0.5, lt=1.0, description="Of detections to a pole.")
    gate_slack_m: float = Field(0.15, ge=0.0, description="Added to the gate within a pass, 1 sd.")
    pass_gap_s: float = Field(20.0, gt=0.0, description="Not detected for longer: a new traversal.")
    merge_max_m: float = Field(0.8, gt=0.0, description="Traversals farther apart are two poles.")
    merge_slack_m: float = Field(
        0.25, ge=0.0, description="Seen from two sides a trunk has two middles: added to the gate."
    )
    merge_probability: float = Field(0.9999, gt=0.5, lt=1.0)
    observations_min: int = Field(8, ge=1, description="A pole seen less often is not mapped.")
    existence_min: float = Field(0.5, ge=0.0, le=1.0, description="Least to stay in the map.")
    false_alarm_probability: float = Field(
        0.04, gt=0.0, lt=0.5, description="Of a detection where no pole stands, a scan."
    )
    independent_look_s: float = Field(
        0.5, gt=0.0, description="Scans closer together share what hides a pole."
    )
    drive_log_odds_max: float = Field(
        3.0, gt=0.0, description="The most that one drive can say for or against a pole."
    )
    log_odds_max: float = Field(
        4.0, gt=0.0, description="Limit of all drives together, so that a map can still change."
    )
    align_max_m: float = Field(3.0, gt=0.0, description="Greatest shift between drives looked for.")
    drift_sd_m: float = Field(
        0.7, gt=0.0, description="Of a reference that drifts, an axis (with --align)."
    )
    drift_time_s: float = Field(100.0, gt=0.0, description="In which it forgets where it was.")
    drift_least_m: float = Field(
        0.12, ge=0.0, description="Traversals that differ by less, 1 sd, are taken as they are."
    )
    tile_m: float = Field(2000.0, gt=0.0, description="Edge of the tiles that workers merge.")
