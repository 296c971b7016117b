"""Settings of map building without reference poses."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class SlamConfig(BaseModel):
    """From odometry, detected poles and GNSS to poses (`polemap map --slam`)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    gnss_sd_m: float = Field(
        2.5, gt=0.0, le=1000.0, description="Standard deviation of a fix at HDOP 1, an axis."
    )
    gnss_correlation_s: float = Field(
        60.0, gt=0.1, le=3600.0, description="Time over which the rest of it wanders."
    )
    loop_log_odds: float = Field(8.0, gt=0.0, description="Least log odds of a loop against none.")
