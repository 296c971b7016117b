"""Every setting of the stereo room, and the one place where its tuned figures stand."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Preprocessing = Literal["none", "clahe", "rank7x7", "partial_ranks", "census_bytes"]

Census = Literal["centre5x5", "symmetric7x7"]

LARGEST_PENALTY = 85  # three path sums above the matching cost must fit one byte


class Penalties(BaseModel):
    """Smoothness of census SGM, in units of the Hamming cost (0 to 24).

    P1 punishes a change of disparity by one pixel between neighbours, P2 a larger change. P2 falls
    with the step of intensity between the two pixels, since depth edges mostly show in the image:
    P2 = max(p2_min, gamma - alpha * |step|).

    Attributes:
        alpha: per grey value of an 8-bit image; for b bits it is divided by 2^(b - 8).

    Source: Spangenberg et al., IV 2014; Spangenberg et al. 2016, section III (7, 17, 50 and 0.25
    a grey value of 12 bit, which is 4 a grey value of 8 bit).
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    p1: int = Field(default=5, ge=0, le=LARGEST_PENALTY)
    p2_min: int = Field(default=8, ge=0, le=LARGEST_PENALTY)
    gamma: int = Field(default=60, ge=0, le=LARGEST_PENALTY)
    alpha: float = Field(default=3.0, ge=0.0, le=64.0)

    @model_validator(mode="after")
    def _in_order(self) -> Penalties:
        if not self.p1 <= self.p2_min <= self.gamma:
            raise ValueError(f"p1 <= p2_min <= gamma, not {self.p1}, {self.p2_min}, {self.gamma}")
        return self


class OpenCvConfig(BaseModel):
    """OpenCV's StereoSGBM and what is put in front of it.

    `p1` and `p2` are per squared block pixel and channel, as OpenCV's own examples give them. Of
    what was measured, CLAHE keeps most poles; ranks and census bytes lose more thin ones.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    mode: Literal["sgbm", "3way", "hh", "hh4"] = "3way"
    preprocessing: Preprocessing = "clahe"
    block_size_px: int = Field(default=3, ge=1, le=11)
    p1: int = Field(default=8, ge=1)
    p2: int = Field(default=32, ge=2)


class StereoConfig(BaseModel):
    """How a pair becomes two disparity maps.

    Attributes:
        matcher: `census_sgm` needs the C++ extension; without it `opencv_sgbm` serves, with one
            warning.
        min_disparity_px: the smallest disparity that is searched.
        disparities: how many are searched, from the smallest upwards.
        paths: directions along which costs are summed.
        right_map: `shared` reads the right view from the sums of the left; `own` sums again with
            the right view's edges, which costs twice the time and keeps more thin poles.
        census: `centre5x5` compares 24 neighbours with the centre; `symmetric7x7` the 24 pairs of
            opposite pixels of a 7x7 window.
        smoothing: rounds of 1-2-1 smoothing of the image that the census sees; the census of a
            noisy pixel is noise.
        uint16_bits: how many bits of a 16-bit image the camera fills.
        uniqueness_percent: the best sum of costs must be this much below every other one that is
            not its direct neighbour.
        left_right_tolerance_px: how far the two maps may disagree; None leaves out the check.
        median: a 3x3 median of the winners before the checks.
        outside_cost: matching cost where the partner would lie outside the other image.
        cost_weight: how often the matching cost counts in the sum over paths, beside what each
            path adds to it. In plain semi-global matching it counts once a path (8), so that one
            noisy pixel outvotes all paths; 1 counts it once (Drory et al., GCPR 2014).
        threads: 1, or 2 (upper and lower half); with `own` also 4. The result is the same.
        instruction_set: for measurements; the result is the same.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    matcher: Literal["census_sgm", "opencv_sgbm"] = "census_sgm"
    min_disparity_px: int = Field(default=0, ge=0, le=512)
    disparities: int = Field(default=128, ge=16, le=256, multiple_of=16)
    uniqueness_percent: int = Field(default=0, ge=0, le=50)
    left_right_tolerance_px: float | None = Field(default=1.5, ge=0.0, le=16.0)
    paths: Literal[4, 8] = 8
    right_map: Literal["shared", "own"] = "own"
    penalties: Penalties = Penalties()
    census: Census = "centre5x5"
    smoothing: int = Field(default=1, ge=0, le=2)
    uint16_bits: int = Field(default=12, ge=8, le=16)
    subpixel: bool = True
    median: bool = False
    outside_cost: int = Field(default=12, ge=0, le=24)
    cost_weight: int = Field(default=1, ge=1, le=16)
    threads: int = Field(default=2, ge=1, le=64)
    instruction_set: Literal["auto", "baseline", "avx2", "avx512"] = "auto"
    opencv: OpenCvConfig = OpenCvConfig()
