"""Streets without poles: what lines and corners give where there is no pole, on drives of points.

    python -m benchmarks.localize.without_poles [SEEDS or FIRST:LAST] [CASE,CASE...]

prints the table of docs/landmarks.md. Errors are of the particle filter, over the part of the drive
that the case names. Not timed, so `python -m benchmarks` leaves it out.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.localize.line_streets import Repaint, Street, street_drive, ways
from benchmarks.localize.particle_filter_recovery import play, rms
from polemap.localize.config import LocalizeConfig
from polemap.localize.particle_filter.estimate import PfEstimate
from polemap.localize.particle_filter.filter import ParticleFilter
from polemap.simulate.points.drive import WHEELBASE_M, PointDrive, PointScenario
from polemap.vehicle.pose import pose_rotation, rotate_back, wrap_angle

Floats = NDArray[np.float64]

_BASE = PointScenario(duration_s=45.0)
_GAP = (150.0, 350.0)
_WHOLE = (-np.inf, np.inf)


@dataclass(frozen=True, slots=True)
class Case:
    """A street, what counts of it, and which ways along it are judged."""

    street: Street
    settings: dict[str, Any] = field(default_factory=dict)
    judged_m: tuple[float, float] = (100.0, np.inf)
    scenario: PointScenario = _BASE


POLES = {"kinds": ("pole",)}
LINES = {"kinds": ("pole", "lane_marking", "kerb")}
CORNERS = {"kinds": ("pole", "corner")}
_BARE = Street(corner_spacing_m=15.0)
_PAINT = replace(_BARE, corner_spacing_m=None)


def _of(street: Street, judged_m: tuple[float, float], name: str) -> dict[str, Case]:
    return {
        f"{name}, poles alone": Case(street, POLES, judged_m),
        f"{name}, lines": Case(street, LINES, judged_m),
        f"{name}, corners": Case(street, CORNERS, judged_m),
        f"{name}, all": Case(street, {}, judged_m),
    }


def _painted(name: str, **paint: Any) -> dict[str, Case]:
    """Markings of 150 m painted anew, the kerbs as they were or unknown; poles there or gone."""
    repaint = Repaint(200.0, 350.0, **paint)
    only = {"kinds": ("pole", "lane_marking")}
    gone = replace(_PAINT, repaint=repaint, no_poles_m=(150.0, 400.0))
    there = replace(_PAINT, repaint=repaint)
    return {
        f"{name}, poles": Case(there, only, (180.0, np.inf)),
        f"{name}, no poles": Case(gone, only, (180.0, 400.0)),
        f"{name}, no poles, kerbs": Case(gone, LINES, (180.0, 400.0)),
    }


def _wrong_corners(name: str, **wrong: Any) -> dict[str, Case]:
    """Corners that are not where the map has them, with poles and in a gap of them."""
    street = replace(_BARE, **wrong)
    return {
        f"{name}, poles": Case(street, CORNERS, (100.0, np.inf)),
        f"{name}, no poles": Case(replace(street, no_poles_m=_GAP), CORNERS, (200.0, 350.0)),
    }


CASES = {
    **_of(replace(_BARE, no_poles_m=_GAP), (200.0, 350.0), "gap of 200 m"),
    **_of(replace(_BARE, no_poles_m=_WHOLE), (200.0, np.inf), "no pole at all"),
    **_of(_BARE, (100.0, np.inf), "poles everywhere"),
    **_painted("moved 0.5 m", left_m=0.5),
    **_painted("moved 1 m", left_m=1.0),
    **_painted("moved 3 m", left_m=3.0),
    **_painted("doubled 0.7 m", left_m=0.7, doubled=True),
    **_painted("missing", missing=True),
    **_wrong_corners("corners moved 1 m", corners_moved_m=1.0),
    **_wrong_corners("corners moved 3 m", corners_moved_m=3.0),
    **_wrong_corners("corners elsewhere", corners_elsewhere=True),
}


def drive_through(case: Case, seed: int) -> tuple[PointDrive, list[PfEstimate], ParticleFilter]:
    """One seeded drive and the estimates of the filter."""
    drive = street_drive(case.scenario, case.street, seed)
    particle_filter = ParticleFilter(
        drive.pole_map,
        LocalizeConfig(**case.settings),
        WHEELBASE_M,
        np.random.default_rng(seed + 1000),
    )
    return drive, play(particle_filter, drive.samples), particle_filter


def judge(case: Case, drive: PointDrive, estimates: list[PfEstimate]) -> dict[str, float]:
    """Errors in the judged part: along, across, yaw, NEES; healthy and usable shares; seconds in
    which a healthy pose was more than 1 m off, or aside by more than 4 stated deviations."""
    stamps = np.array([e.stamp_s for e in estimates])
    truth = drive.motion.at(stamps)
    states = drive.motion.states
    way = np.interp(stamps, drive.motion.stamp_s, ways(states))
    rows = (way >= case.judged_m[0]) & (way <= case.judged_m[1])
    offset = np.array([e.pose for e in estimates]) - truth
    offset[:, 2] = wrap_angle(offset[:, 2])
    stated = np.array([e.covariance for e in estimates])
    nees = np.einsum("ni,nij,nj->n", offset, np.linalg.inv(stated), offset) / 3.0
    along, across = rotate_back(offset[:, :2], truth[:, 2]).T
    turn = pose_rotation(-truth[:, 2])
    own = turn @ stated @ turn.transpose(0, 2, 1)
    healthy = np.array([e.healthy for e in estimates])
    wrong = healthy & (np.hypot(along, across) > 1.0)
    sure = healthy & (np.abs(across) > 4.0 * np.sqrt(own[:, 1, 1]))
    step = np.diff(stamps, append=stamps[-1])
    return {
        "lateral_m": rms(across[rows]),
        "along_m": rms(along[rows]),
        "yaw_deg": float(np.degrees(rms(offset[rows, 2]))),
        "nees": float(nees[rows].mean()),
        "along_sd_m": float(np.sqrt(own[rows, 0, 0].mean())),
        "lateral_sd_m": float(np.sqrt(own[rows, 1, 1].mean())),
        "healthy": float(healthy[rows].mean()),
        "usable": float(np.array([e.usable for e in estimates])[rows].mean()),
        "wrong_s": float(step[wrong].sum()),
        "too_sure_s": float(step[sure].sum()),
        "largest_lateral_m": float(np.abs(across[rows]).max()),
    }


def main(seeds: int, names: list[str], first: int = 0) -> None:
    print(
        "case | lateral (worst seed, largest), stated [m] | along, stated [m] | yaw [deg] | NEES "
        "| healthy, usable | healthy and > 1 m off | ... and > 4 sd aside | counted"
    )
    for name in names:
        rows: list[dict[str, float]] = []
        counts: Counter[str] = Counter()
        for seed in range(first, first + seeds):
            drive, estimates, particle_filter = drive_through(CASES[name], seed)
            rows.append(judge(CASES[name], drive, estimates))
            counts += particle_filter.counts
        mean = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
        worst = {key: float(np.max([row[key] for row in rows])) for key in rows[0]}
        print(
            f"{name} | {mean['lateral_m']:.3f} ({worst['lateral_m']:.3f}, "
            f"{worst['largest_lateral_m']:.2f}), {mean['lateral_sd_m']:.3f} | "
            f"{mean['along_m']:.2f}, {mean['along_sd_m']:.2f} | {mean['yaw_deg']:.2f} | "
            f"{mean['nees']:.2f} | {mean['healthy']:.2f}, {mean['usable']:.2f} | "
            f"{worst['wrong_s']:.1f} s | {worst['too_sure_s']:.1f} s | {dict(counts)}",
            flush=True,
        )


if __name__ == "__main__":
    chosen = sys.argv[2].split(";") if len(sys.argv) > 2 else list(CASES)
    begin, _, end = (sys.argv[1] if len(sys.argv) > 1 else "20").rpartition(":")
    main(int(end) - int(begin or 0), chosen, int(begin or 0))
