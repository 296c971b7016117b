"""Every setting of the stereo room, and the one place where its tuned figures stand."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from polemap.plugins import MATCHERS, installed

OWN_MATCHERS = ("census_sgm", "opencv_sgbm")
Census = Literal["tall", "centre5x5", "symmetric7x7"]
Preprocessing = Literal["none", "clahe", "rank7x7", "partial_ranks", "census_bytes"]

LARGEST_PENALTY = 150  # a path cost must fit one byte
LARGEST_SUM = 255  # what the vertical and two diagonal paths add must fit one byte, too


class StepPenalty(BaseModel):
    """P2, for a change of disparity by more than one pixel between neighbours on a path.

    It falls with the step of intensity between the two pixels, since depth edges mostly show in
    the image: P2 = gamma - alpha * |step|, kept within p2_min and p2_max. With gamma above p2_max
    the first (gamma - p2_max) / alpha grey values count as noise.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    p2_min: int = Field(ge=0, le=LARGEST_PENALTY, description="Least P2, at a strong step.")
    p2_max: int = Field(ge=0, le=LARGEST_PENALTY, description="Greatest P2, without a step.")
    gamma: int = Field(ge=0, le=1000, description="P2 before the step is taken off.")
    alpha: float = Field(
        ge=0.0,
        le=64.0,
        description="Per grey value of an 8-bit image; for b bits it is divided by 2^(b - 8).",
    )

    @model_validator(mode="after")
    def _in_order(self) -> StepPenalty:
        if not self.p2_min <= self.p2_max <= self.gamma:
            raise ValueError(
                f"p2_min <= p2_max <= gamma, not {self.p2_min}, {self.p2_max}, {self.gamma}"
            )
        return self


class Penalties(BaseModel):
    """Smoothness of census SGM, in units of the Hamming cost (0 to 24).

    P1 punishes a change of disparity by one pixel between neighbours. P2 (see `StepPenalty`) has
    a law of its own for vertical steps: along a pole or a trunk nothing changes, so what the rows
    above and below found may weigh more there (a path can add P2 at most) than what crosses it.

    Source: Spangenberg et al., IV 2014; Spangenberg et al. 2016, section III (7, 17, 50 and 0.25
    a grey value of 12 bit, which is 4 a grey value of 8 bit, in all directions).
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    p1: int = Field(default=5, ge=0, le=60, description="For a change by one pixel.")
    across: StepPenalty = StepPenalty(p2_min=5, p2_max=60, gamma=180, alpha=20.0)
    upright: StepPenalty = StepPenalty(p2_min=20, p2_max=120, gamma=150, alpha=2.0)

    @model_validator(mode="after")
    def _in_order(self) -> Penalties:
        for name, law in (("across", self.across), ("upright", self.upright)):
            if self.p1 > law.p2_min:
                raise ValueError(f"p1 <= p2_min, not {self.p1} and {law.p2_min} ({name})")
        most = self.upright.p2_max + 2 * self.across.p2_max
        if most > LARGEST_SUM:
            raise ValueError(
                f"upright.p2_max + 2 across.p2_max is {most}, above {LARGEST_SUM}: lower one"
            )
        return self


def _known_matcher(name: str) -> str:
    known = [*OWN_MATCHERS, *installed(MATCHERS)]
    if name not in known:
        raise ValueError(f"no such matcher; installed are {', '.join(known)}")
    return name


class StereoConfig(BaseModel):
    """How a pair becomes two disparity maps."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    matcher: Annotated[str, AfterValidator(_known_matcher)] = Field(
        default="census_sgm",
        description=(
            "`census_sgm`, which needs the C++ extension (without it `opencv_sgbm` serves, with "
            "one warning), `opencv_sgbm`, or that of a plug-in (docs/plugins.md)."
        ),
    )
    min_disparity_px: int = Field(
        default=0, ge=0, le=512, description="The smallest disparity that is searched."
    )
    disparities: int = Field(
        default=128,
        ge=16,
        le=256,
        multiple_of=16,
        description="How many are searched, from the smallest upwards.",
    )
    search: Literal["full", "strips"] = Field(
        default="full",
        description=(
            "`full` searches all disparities everywhere. `strips` takes half to three quarters of "
            "the time: it looks at the pair at half its width and a quarter of its height first, "
            "and searches each strip of 32 rows 8 px farther than anything shows there, and 48 "
            "disparities at least; of 64 or fewer all are searched."
        ),
    )
    uniqueness_percent: int = Field(
        default=0,
        ge=0,
        le=50,
        description=(
            "The best sum of costs must be this much below every other one that is not its "
            "direct neighbour."
        ),
    )
    left_right_tolerance_px: float | None = Field(
        default=2.5,
        ge=0.0,
        le=16.0,
        description="How far the two maps may disagree; None leaves out the check.",
    )
    paths: Literal[4, 8] = Field(default=8, description="Directions along which costs are summed.")
    right_map: Literal["shared", "own"] = Field(
        default="own",
        description=(
            "`shared` reads the right view from the sums of the left; `own` sums again with "
            "the right view's edges, which costs twice the time and keeps more thin poles."
        ),
    )
    penalties: Penalties = Field(default=Penalties(), description="Smoothness of census SGM.")
    census: Census = Field(
        default="tall",
        description=(
            "`tall` compares 24 pairs in a window 9 to 11 rows high and 3 to 5 columns "
            "wide, as poles are; `centre5x5` 24 neighbours with the centre; `symmetric7x7` "
            "the 24 pairs of opposite pixels of a 7x7 window."
        ),
    )
    smoothing: Literal["none", "upright", "square"] = Field(
        default="upright",
        description=(
            "1-2-1 sums of the image before the census, since that of a noisy pixel is noise: "
            "`upright` over three rows, which leaves the width of a pole alone, or `square`; "
            "`none` in S16."
        ),
    )
    cost_weight: int = Field(
        default=1,
        ge=1,
        le=8,
        description=(
            "How often the matching cost counts in the sum over the paths: once (Drory et al., "
            "GCPR 2014), or once a path (4 or 8), as plain semi-global matching has it."
        ),
    )
    opencv_preprocessing: Preprocessing = Field(
        default="clahe",
        description=(
            "What `opencv_sgbm` is given to see: the images as they are, with their local contrast "
            "evened out (CLAHE), ranks in a 7x7 window, those of its three thirds, or the 24 bits "
            "of a 5x5 census as three channels (docs/stereo.md)."
        ),
    )
    uint16_bits: int = Field(
        default=12, ge=8, le=16, description="How many bits of a 16-bit image the camera fills."
    )
    speckle_px: int = Field(
        default=400,
        ge=0,
        le=100_000,
        description=(
            "Connected components of fewer pixels are removed, 0 for none, unless they are "
            "16 rows tall, as what is left of a thin pole is."
        ),
    )
    outlier_chance_max: float = Field(
        default=1.0,
        gt=0.0,
        le=1.0,
        description=(
            "Disparities whose chance of being over 3 px off (`stereo/trust.py`) is larger "
            "are dropped, in both views; 1 keeps all."
        ),
    )
    threads: int = Field(
        default=2,
        ge=1,
        le=64,
        description="1, or 2 (upper and lower half); with `own` also 4. The result is the same.",
    )
