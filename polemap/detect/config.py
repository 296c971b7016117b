"""Settings of the detector: how a stereo frame becomes poles."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from polemap.drivelog.landmark_kind import LandmarkKind

KindName = Literal["pole", "corner", "lane_marking", "kerb", "facade"]


class DetectionConfig(BaseModel):
    """From a disparity pair to classified pole hypotheses.

    Lengths are metric wherever possible, so that one set of values serves every camera.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kinds: tuple[KindName, ...] = Field(
        ("pole",),
        description="What is looked for; `pole` always, as poles tell the camera's error.",
    )
    model: str = Field("default", description="Built-in classifier name, or a path to its JSON.")
    corner_model: str = Field("corners", description="The same of the classifier of corners.")
    row_step_px: int = Field(
        3, ge=1, le=8, description="Every n-th image row is searched for depth edges."
    )
    range_min_m: float = Field(3.0, gt=0.0, description="Nearer hypotheses are left out.")
    range_max_m: float = Field(
        30.0, gt=0.0, le=100.0, description="Farther hypotheses are left out."
    )
    width_min_m: float = Field(0.03, gt=0.0, description="Thinner things are no poles.")
    width_max_m: float = Field(1.1, gt=0.0, description="Wider things are no poles.")
    height_min_m: float = Field(0.35, gt=0.0, description="Least upright extent with depth edges.")
    probability_min: float = Field(
        0.5, ge=0.0, le=1.0, description="From here on a hypothesis is called a pole."
    )

    @model_validator(mode="after")
    def _poles_among_kinds(self) -> Self:
        if "pole" not in self.kinds or len(set(self.kinds)) < len(self.kinds):
            raise ValueError(f"kinds {list(self.kinds)}: each once, and pole among them")
        return self

    @property
    def landmark_kinds(self) -> frozenset[LandmarkKind]:
        """The `kinds` as such."""
        return frozenset(LandmarkKind[name.upper()] for name in self.kinds)
