"""The studies of closed loops by name, beside the papers' estimation studies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from polemap.electric.studies.study import Report, Study
from polemap.simulate.closed_loop.cornering_study import cornering_study
from polemap.simulate.closed_loop.lane_keeping_study import lane_keeping_study
from polemap.simulate.closed_loop.lane_study import lane_study
from polemap.simulate.closed_loop.margin_study import margin_study
from polemap.simulate.closed_loop.path_study import path_study
from polemap.simulate.closed_loop.slip_study import slip_study
from polemap.vehicle.parameters import Car


class LoopStudy(Protocol):
    """A study that takes any estimators; none means its usual ones."""

    def __call__(
        self, car: Car, seeds: int, report: Report, estimators: tuple[str, ...], /
    ) -> Study: ...


@dataclass(frozen=True, slots=True)
class Entry:
    """A study of closed loops.

    Attributes:
        run: the study.
        seeds: how many drives it takes by default.
        car: the car that it is about, unless another is asked for.
        apart: takes so long that `all` leaves it out.
    """

    run: LoopStudy
    seeds: int
    car: str = "coms"
    apart: bool = False


def _full_loop(car: Car, seeds: int, report: Report, estimators: tuple[str, ...]) -> Study:
    # perception and map building are slow to import, and no other study needs them
    from polemap.simulate.closed_loop.full_loop_study import full_loop_study

    return full_loop_study(car, seeds, report, estimators)


LOOP_STUDIES: dict[str, Entry] = {
    "N13-slip": Entry(slip_study, 3),
    "N13-cornering": Entry(cornering_study, 3),
    "W13-lane-keeping": Entry(lane_keeping_study, 3),
    "W14-lane-change": Entry(lane_study, 3),
    "W14-margins": Entry(margin_study, 1),
    "path-following": Entry(path_study, 3, "passat"),
    "full-loop": Entry(_full_loop, 3, "passat", apart=True),
}
"""By name."""
