"""Opens what the runs of a report came from: drives, maps, truth, trajectories to compare."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from polemap.drivelog.errors import InputError, PolemapError
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.tum import read_tum
from polemap.evaluation.alignment import Alignment, align
from polemap.evaluation.routes import Recording, Route, median_track, same_course, unused_name
from polemap.evaluation.runs.io import RunSet
from polemap.evaluation.verdict import built_from
from polemap.map.city.city_map import along
from polemap.map.city.io import open_map
from polemap.map.pole_map import PoleMap
from polemap.parsing.csv_text import read_rows
from polemap.parsing.errors import named
from polemap.vehicle.trajectory import Trajectory

# of a city the poles that pictures and bounds of a route need
POLES_AROUND_M = 200.0
# farther from the runs than their extent and this, a trajectory is one of another origin
_OTHER_ORIGIN_M = 1000.0


def open_routes(
    run_sets: Sequence[RunSet],
    added: Mapping[str, Path] | None = None,
    max_runs: int | None = None,
    alignment: Alignment = "none",
) -> list[Route]:
    """Group run sets into routes; read their drives and maps where these are still there.

    Two run sets of the same drive and lap are two settings. Recordings belong to one route if
    they come from one drive, or stand in one frame and cover half of each other's course.

    Raises:
        InputError: an added trajectory shares no time with any recording, or lies far from it.
    """
    grouped: dict[tuple[str, str | None], dict[str, RunSet]] = {}
    for one in run_sets:
        key = (os.path.realpath(one.drive or one.path), one.lap)
        settings = grouped.setdefault(key, {})
        settings[unused_name(one.name, settings) if settings else ""] = one
    recordings, notes = [], []
    for settings in grouped.values():
        recording, remarks = _open_recording(settings, max_runs)
        recordings.append(recording)
        notes.append(remarks)
    recordings, done = _with_added(recordings, added or {}, alignment)
    routes: list[Route] = []
    for members in same_course(recordings):
        drive = recordings[members[0]].drive
        first = drive.name if drive is not None else recordings[members[0]].name
        remarks = [note for i in members for note in notes[i]]
        remarks += [text for i in members for text in done.get(i, ())]
        pole_map = _open_map(recordings[members[0]], remarks)
        remarks += [text for i in members for text in _own_map(recordings[i], pole_map)]
        name = unused_name(first.split(":")[0], {route.name: None for route in routes})
        ours = tuple(recordings[i] for i in members)
        routes.append(Route(name, ours, pole_map, tuple(dict.fromkeys(remarks))))
    return routes


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
        drive = open_drive(main.drive, topics=main.topics)
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
        frame = recording.drive.frame if recording.drive else None
        return along(
            open_map(main.map, frame), recording.guide.poses[:, :2], POLES_AROUND_M, ("history",)
        )
    except (PolemapError, ValueError, OSError) as error:
        notes.append(f"{main.name}: its map cannot be read any more ({error})")
        return None


def _own_map(recording: Recording, pole_map: PoleMap | None) -> list[str]:
    """Whether the map was built from the drive that was localized in it."""
    if pole_map is None or recording.drive is None:
        return []
    lap = recording.main.lap
    try:
        part = recording.drive.lap(lap) if lap is not None else recording.drive
    except InputError:
        return []
    if not built_from(pole_map, part):
        return []
    return [f"{recording.name}: its map was built from this drive: the figures flatter"]


def _check_near(path: Path, track: Trajectory, goal: Trajectory) -> None:
    """Refuse a trajectory of another origin: its errors would be the distance of two origins."""
    between = np.median(track.poses[:, :2], axis=0) - np.median(goal.poses[:, :2], axis=0)
    extent_m = float(np.ptp(goal.poses[:, :2], axis=0).max())
    far_m = float(np.hypot(*between))
    if far_m > _OTHER_ORIGIN_M + extent_m:
        raise InputError(
            f"{path}: lies {far_m / 1e3:.1f} km from the runs; give it in their frame, or --align "
            "origin or se2"
        )


def _with_added(
    recordings: list[Recording], added: Mapping[str, Path], alignment: Alignment
) -> tuple[list[Recording], dict[int, list[str]]]:
    """Give every recording the part of each added trajectory that shares its time.

    Returns:
        The recordings, and by their number how the trajectories were aligned.
    """
    result = list(recordings)
    done: dict[int, list[str]] = {}
    for name, path in added.items():
        track = read_tum(path)
        used = False
        for number, one in enumerate(result):
            goal = one.reference if one.reference is not None else one.guide
            shared = track
            timed = alignment.startswith("time")
            if timed:
                shared, text = align(track, goal, alignment, name)
            start, end = one.guide.stamp_s[0], one.guide.stamp_s[-1]
            part = shared.between(float(start), float(end))
            if len(part) > 1:
                used = True
                if not timed:
                    part, text = align(part, goal, alignment, name)
                _check_near(path, part, goal)
                done.setdefault(number, []).append(text)
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
                f"time with the runs ({spans}); bring them to one clock, or --align time"
            )
    return result, done
