"""Settings of map building and upkeep."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class MappingConfig(BaseModel):
    """From sightings and reference poses to a map."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    reference_sd_m: float = Field(
        0.05, gt=0.0, description="Of reference poses that state none, an axis."
    )
    reference_yaw_sd_rad: float = Field(0.003, ge=0.0, description="Shared by a pass.")
    systematic_sd_m: float = Field(
        0.02, ge=0.0, description="Error of a detector that no repetition averages away."
    )
    disparity_pass_sd_px: float = Field(
        0.22,
        ge=0.0,
        description="Disparity error of a stem that all looks of one pass share (stereo only).",
    )
    disparity_common_sd_px: float = Field(
        0.2,
        ge=0.0,
        description="Disparity error that all passes of all drives share (calibration).",
    )
    range_max_m: float = Field(60.0, gt=0.0, description="Sightings farther away are left out.")
    gate_probability: float = Field(0.997, gt=0.5, lt=1.0, description="Of sightings to a pole.")
    gate_slack_m: float = Field(0.15, ge=0.0, description="Added to the gate within a pass, 1 sd.")
    pass_gap_s: float = Field(20.0, gt=0.0, description="Unseen for longer: a new pass.")
    merge_max_m: float = Field(0.8, gt=0.0, description="Passes farther apart are two poles.")
    merge_slack_m: float = Field(
        0.25, ge=0.0, description="Seen from two sides a trunk has two middles: added to the gate."
    )
    merge_probability: float = Field(0.9999, gt=0.5, lt=1.0)
    observations_min: int = Field(8, ge=1, description="A pole seen less often is not mapped.")
    existence_min: float = Field(0.5, ge=0.0, le=1.0, description="Least to stay in the map.")
    false_alarm_probability: float = Field(
        0.04, gt=0.0, lt=0.5, description="Of seeing something where no pole stands, a look."
    )
    independent_look_s: float = Field(
        0.5, gt=0.0, description="Looks closer together share what hides a pole."
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
        0.12, ge=0.0, description="Passes that differ by less, 1 sd, are taken as they are."
    )
    tile_m: float = Field(2000.0, gt=0.0, description="Edge of the tiles that workers merge.")
