"""Settings of the pole room: how poles are detected, tracked and mapped."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from polemap.build.config import MappingConfig
from polemap.build.slam.config import SlamConfig
from polemap.detect.config import DetectionConfig
from polemap.track.config import TrackingConfig


class PolemapConfig(BaseModel):
    """Settings of the pole room."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    detection: DetectionConfig = DetectionConfig()
    tracking: TrackingConfig = TrackingConfig()
    mapping: MappingConfig = MappingConfig()
    slam: SlamConfig = SlamConfig()
