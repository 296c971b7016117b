"""Which runs belong together: recordings of one route, and several settings of one recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from polemap.drivelog.drive import Drive, open_drive
from polemap.drivelog.errors import InputError, PolemapError
from polemap.drivelog.tum import read_tum
from polemap.evaluation.exclusions import START_UP_S
from polemap.evaluation.laps import SAME_ROAD_M, Span
from polemap.evaluation.runs.io import RunSet
from polemap.map.io import read_map
from polemap.map.landmark_map import PoleMap
from polemap.parsing.csv_text import read_rows
from polemap.parsing.errors import named
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


def open_routes(
    run_sets: Sequence[RunSet], added: Mapping[str, Path] | None = None, max_runs: int | None = None
) -> list[Route]:
    """Group run sets into routes; read their drives and maps where these are still there.

    Two run sets of the same drive and lap are two settings. Recordings belong to one route if
    they come from one drive, or stand in one frame and cover half of each other's course.

    Raises:
        InputError: an added trajectory shares no time with any recording.
    """
    grouped: dict[tuple[str, str | None], dict[str, RunSet]] = {}
    for one in run_sets:
        key = (str(one.drive.resolve() if one.drive else one.path.resolve()), one.lap)
        settings = grouped.setdefault(key, {})
        settings[_unused(one.name, settings) if settings else ""] = one
    recordings, notes = [], []
    for settings in grouped.values():
        recording, remarks = _open_recording(settings, max_runs)
        recordings.append(recording)
        notes.append(remarks)
    recordings = _with_added(recordings, added or {})
    routes: list[Route] = []
    for members in _same_course(recordings):
        drive = recordings[members[0]].drive
        first = drive.name if drive is not None else recordings[members[0]].name
        remarks = [note for i in members for note in notes[i]]
        pole_map = _open_map(recordings[members[0]], remarks)
        name = _unused(first.split(":")[0], {route.name: None for route in routes})
        ours = tuple(recordings[i] for i in members)
        routes.append(Route(name, ours, pole_map, tuple(dict.fromkeys(remarks))))
    return routes


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


def _open_recording(
    settings: Mapping[str, RunSet], max_runs: int | None
) -> tuple[Recording, list[str]]:
    main = next(iter(settings.values()))
    notes = [note for one in settings.values() for note in one.notes]
    guide = median_track([run.kf for run in main.runs[:max_runs]])
    name = main.name
    if main.drive is None:
        notes.append(f"{name}: config.yaml names no drive; no reference, laps.csv or map picture")
        return Recording(name, settings, guide), notes
    try:
        drive = open_drive(main.drive)
        truth = _read_truth(main.drive)
    except (PolemapError, ValueError, OSError) as error:
        notes.append(f"{name}: its drive cannot be read any more ({error}); no reference, no laps")
        return Recording(name, settings, guide), notes
    notes.extend(f"{drive.name}: {note}" for note in drive.notes)
    reference, sd_m = None, float("nan")
    if drive.reference is not None and len(drive.reference) > 1:
        stream = drive.reference
        reference = Trajectory(stream.stamp_s, stream.poses)
        known = stream.sd_m[np.isfinite(stream.sd_m)]
        sd_m = float(np.median(known)) if len(known) else float("nan")
    return Recording(name, settings, guide, drive, reference, sd_m, truth), notes


def _read_truth(folder: Path) -> Trajectory | None:
    """What the simulator writes beside a drive: `truth.csv` (columns of reference.csv)."""
    if (folder / "truth.tum").is_file():
        return read_tum(folder / "truth.tum")
    path = folder / "truth.csv"
    if not path.is_file():
        return None
    with named(path, InputError, "table"):
        header, *body = read_rows(path) or [[]]
        rows = [dict(zip(header, cells, strict=False)) for cells in body if cells]
    wanted = ("stamp_s", "east_m", "north_m", "yaw_rad")
    try:
        table = np.array([[float(row[name]) for name in wanted] for row in rows])
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{path}: expected columns {', '.join(wanted)} with numbers") from None
    return Trajectory(table[:, 0], table[:, 1:]) if len(table) > 1 else None


def _open_map(recording: Recording, notes: list[str]) -> PoleMap | None:
    main = recording.main
    if main.map is None:
        notes.append(f"{main.name}: config.yaml names no map; no poles in the pictures")
        return None
    try:
        return read_map(main.map, frame=recording.drive.frame if recording.drive else None)
    except (PolemapError, ValueError, OSError) as error:
        notes.append(f"{main.name}: its map cannot be read any more ({error})")
        return None


def _with_added(recordings: list[Recording], added: Mapping[str, Path]) -> list[Recording]:
    """Give every recording the part of each added trajectory that shares its time."""
    result = list(recordings)
    for name, path in added.items():
        track = read_tum(path)
        used = False
        for number, one in enumerate(result):
            start, end = one.guide.stamp_s[0], one.guide.stamp_s[-1]
            part = track.between(float(start), float(end))
            if len(part) > 1:
                used = True
                result[number] = Recording(
                    one.name, one.settings, one.guide, one.drive, one.reference,
                    one.reference_sd_m, one.truth, {**one.added, name: part},
                )  # fmt: skip
        if not used:
            spans = ", ".join(
                f"{r.name} {r.guide.stamp_s[0]:.3f} to {r.guide.stamp_s[-1]:.3f} s"
                for r in recordings
            )
            raise InputError(
                f"{path}: its stamps {track.stamp_s[0]:.3f} to {track.stamp_s[-1]:.3f} s share no "
                f"time with the runs ({spans}); stamps must be on the recording's clock"
            )
    return result


def _same_course(recordings: Sequence[Recording]) -> list[list[int]]:
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
    there = np.isfinite(KDTree(first).query(second, distance_upper_bound=SAME_ROAD_M)[0])
    back = np.isfinite(KDTree(second).query(first, distance_upper_bound=SAME_ROAD_M)[0])
    return bool(min(there.mean(), back.mean()) >= SHARED_ROAD)


def _unused(name: str, taken: Mapping[str, object]) -> str:
    if name not in taken:
        return name
    number = 2
    while f"{name} ({number})" in taken:
        number += 1
    return f"{name} ({number})"
