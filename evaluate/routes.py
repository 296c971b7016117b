"""Which runs belong together: recordings of one route, and several settings of one recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.evaluation.exclusions import START_UP_S
from polemap.evaluation.laps import SAME_ROAD_M, Span
from polemap.evaluation.runs.io import RunSet
from polemap.map.pole_map import PoleMap
from polemap.vehicle.pose import wrap_angle
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]

SHARED_ROAD = 0.5


@dataclass(frozen=True, slots=True)
class Recording:
    """One drive, or one lap of it, localized under one or several settings.

    Attributes:
        settings: run sets by the label of the setting; the first, labelled "", is the one that
            the report follows, the others are compared with it.
        guide: pointwise median over the runs of the output filter of the first setting.
        drive: None where the drive can no longer be read; the notes say so.
        reference: of the drive; `reference_sd_m` is its own median standard deviation (NaN
            where it does not say).
        truth: what the simulator knows.
    """

    name: str
    settings: Mapping[str, RunSet]
    guide: Trajectory
    drive: Drive | None = None
    reference: Trajectory | None = None
    reference_sd_m: float = float("nan")
    truth: Trajectory | None = None
    added: Mapping[str, Trajectory] = field(default_factory=dict)

    @property
    def main(self) -> RunSet:
        """The run set of the first setting."""
        return next(iter(self.settings.values()))

    @property
    def settled_s(self) -> float:
        """From here on poses count for a repeatability: `START_UP_S` after the first of the PF."""
        return max(float(run.pf.stamp_s[0]) for run in self.main.runs) + START_UP_S


@dataclass(frozen=True, slots=True)
class Route:
    """Recordings that drive the same course."""

    name: str
    recordings: tuple[Recording, ...]
    pole_map: PoleMap | None = None
    notes: tuple[str, ...] = ()

    @property
    def setting_names(self) -> tuple[str, ...]:
        """Labels of the settings that every recording of the route has."""
        first = self.recordings[0].settings
        return tuple(n for n in first if all(n in r.settings for r in self.recordings))

    def setting_mark(self, setting: str) -> str:
        """What follows a system's name to tell the settings apart; nothing if there is one."""
        if len(self.setting_names) == 1:
            return ""
        return f" [{setting or self.recordings[0].main.name}]"

    def named_laps(self) -> list[Span]:
        """The rows of laps.csv of every recording; a run on one lap counts as that lap."""
        spans = []
        for source, recording in enumerate(self.recordings):
            laps = recording.drive.laps if recording.drive else ()
            start, end = float(recording.guide.stamp_s[0]), float(recording.guide.stamp_s[-1])
            lap_name = recording.main.lap
            if lap_name is not None and ":" not in lap_name:
                spans.append(Span(source, start, end, lap_name))
                continue
            several = len(self.recordings) > 1
            for lap in laps:
                if lap.end_s > start and lap.start_s < end:
                    name = f"{recording.name} {lap.name}" if several else lap.name
                    spans.append(Span(source, max(lap.start_s, start), min(lap.end_s, end), name))
            if not laps and several:
                spans.append(Span(source, start, end, recording.name))
        return spans


def median_track(tracks: Sequence[Trajectory], spacing_m: float = 0.25) -> Trajectory:
    """Pointwise median over runs on the clock of the first, thinned; robust to a lost run."""
    first = tracks[0].thinned(spacing_m)
    if len(tracks) == 1:
        return first
    stack = np.stack([first.poses, *(one.at(first.stamp_s) for one in tracks[1:])])
    turn = wrap_angle(stack[:, :, 2] - first.poses[:, 2])
    poses = np.column_stack(
        [
            np.nanmedian(stack[:, :, 0], axis=0),
            np.nanmedian(stack[:, :, 1], axis=0),
            wrap_angle(first.poses[:, 2] + np.nanmedian(turn, axis=0)),
        ]
    )
    return Trajectory(first.stamp_s, poses)


def same_course(recordings: Sequence[Recording]) -> list[list[int]]:
    """Indices of the recordings of every route, in the order given."""
    groups: list[list[int]] = []
    for number, one in enumerate(recordings):
        for group in groups:
            if _belong_together(recordings[group[0]], one):
                group.append(number)
                break
        else:
            groups.append([number])
    return groups


def _belong_together(a: Recording, b: Recording) -> bool:
    if a.main.drive is not None and a.main.drive == b.main.drive:
        return True
    if a.drive is not None and b.drive is not None and a.drive.frame != b.drive.frame:
        return False
    first, second = (one.guide.thinned(2.0).poses[:, :2] for one in (a, b))
    there = np.isfinite(
        scipy.spatial.KDTree(first).query(second, distance_upper_bound=SAME_ROAD_M)[0]
    )
    back = np.isfinite(
        scipy.spatial.KDTree(second).query(first, distance_upper_bound=SAME_ROAD_M)[0]
    )
    return bool(min(there.mean(), back.mean()) >= SHARED_ROAD)


def unused_name(name: str, taken: Mapping[str, object]) -> str:
    """The name, with a number behind it where it is taken."""
    if name not in taken:
        return name
    number = 2
    while f"{name} ({number})" in taken:
        number += 1
    return f"{name} ({number})"
