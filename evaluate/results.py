"""What the evaluation of a route found: the systems, and their figures."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from polemap.evaluation.bootstrap import Blocks
from polemap.evaluation.errors import Errors
from polemap.evaluation.exclusions import (
    Exclusion,
)
from polemap.evaluation.laps import Stretch
from polemap.evaluation.repeatability import (
    LEVEL,
    Crossing,
    Deviations,
    Repeatability,
)
from polemap.evaluation.routes import Route
from polemap.vehicle.kalman import chi_square_quantile
from polemap.vehicle.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class System:
    """One line of the tables: a trajectory a run and recording, and where it came from.

    `kind` is pf, kf, reference, truth or added; `tracks[run][recording]`. Errors count from
    `counts_from_s[run][recording]` on, the first pose on poles of an output filter; empty for all.
    """

    name: str
    kind: str
    setting: str
    tracks: tuple[tuple[Trajectory, ...], ...]
    counts_from_s: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True, slots=True)
class SystemResult:
    """What the report says about one system on one route.

    Attributes:
        repeatability: one a run.
        lost_share: per run, of the places that count, where the system was missing or further
            from the path than its reach.
        example: deviations of the first run, excluded parts left out.
        blocks: squared centred deviations over `BLOCK_M` of road, for the bootstrap.
        true_lateral_rms_m: per run, against the truth (else the reference) at the same station.
        accuracy: per run, `errors.summary` over all recordings, and that of the start as
            `start_...`; empty without a reference.
        errors: of the first run, one a recording.
        error_blocks: by kind of error, for the bootstrap.
    """

    system: System
    repeatability: tuple[Repeatability, ...]
    lost_share: tuple[float, ...]
    example: tuple[Deviations, ...]
    blocks: Blocks
    true_lateral_rms_m: tuple[float, ...]
    accuracy: tuple[dict[str, float], ...]
    errors: tuple[Errors, ...]
    error_blocks: dict[str, Blocks]

    @property
    def sd_m(self) -> float:
        """Mean of the runs: the figure of the tables."""
        return float(np.mean([one.sd_m for one in self.repeatability]))

    @property
    def spread_m(self) -> float:
        """Standard deviation over the runs; NaN for one run."""
        values = [one.sd_m for one in self.repeatability]
        return float(np.std(values, ddof=1)) if len(values) > 1 else float("nan")

    def interval_m(self) -> tuple[float, float]:
        """95 % interval for the laps as a sample of all laps: chi-square, median freedom."""
        freedom = float(np.median([one.freedom for one in self.repeatability]))
        root = sqrt(float(np.mean([one.sd_m**2 for one in self.repeatability])))
        if not freedom > 0.0 or not np.isfinite(root):
            return (float("nan"), float("nan"))
        high = chi_square_quantile(0.5 + LEVEL / 2, freedom)
        low = chi_square_quantile(0.5 - LEVEL / 2, freedom)
        return (root * sqrt(freedom / high), root * sqrt(freedom / low))


@dataclass(frozen=True, slots=True)
class RouteResult:
    """Everything that the tables and pictures of one route need."""

    route: Route
    stretches: tuple[Stretch, ...]
    crossed: tuple[tuple[Crossing, ...], ...]
    judge: str
    exclusions: tuple[Exclusion, ...]
    systems: tuple[SystemResult, ...]
    against: str | None
    notes: tuple[str, ...]

    def of_kind(self, kind: str) -> SystemResult | None:
        """The first system of a kind."""
        return next((one for one in self.systems if one.system.kind == kind), None)
