"""Every setting of the stereo room, and the one place where its tuned figures stand."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

Preprocessing = Literal["none", "clahe", "rank7x7", "partial_ranks", "census_bytes"]


class OpenCvConfig(BaseModel):
    """OpenCV's StereoSGBM and what is put in front of it.

    `p1` and `p2` are per squared block pixel and channel, as OpenCV's own examples give them.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    mode: Literal["sgbm", "3way", "hh", "hh4"] = "3way"
    preprocessing: Preprocessing = "partial_ranks"
    block_size_px: int = Field(default=3, ge=1, le=11)
    p1: int = Field(default=16, ge=1)
    p2: int = Field(default=96, ge=2)


class StereoConfig(BaseModel):
    """How a pair becomes two disparity maps.

    Attributes:
        matcher: `census_sgm` needs the C++ extension; without it `opencv_sgbm` serves, with one
            warning.
        min_disparity_px: the smallest disparity that is searched.
        disparities: how many are searched, from the smallest upwards.
        uniqueness_percent: the best sum of costs must be this much below every other one that is
            not its direct neighbour.
        left_right_tolerance_px: how far the two maps may disagree; None leaves out the check.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    matcher: Literal["census_sgm", "opencv_sgbm"] = "census_sgm"
    min_disparity_px: int = Field(default=0, ge=0, le=512)
    disparities: int = Field(default=128, ge=16, le=256, multiple_of=16)
    uniqueness_percent: int = Field(default=5, ge=0, le=50)
    left_right_tolerance_px: float | None = Field(default=1.0, ge=0.0, le=16.0)
    opencv: OpenCvConfig = OpenCvConfig()
