"""What drives observed to one map: align, merge, weigh the evidence, number the poles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from polemap.build.city.tiles import Run, here, merge_tiles
from polemap.build.config import MappingConfig
from polemap.build.drift import measure_drift
from polemap.build.drive_observations import DriveObservations, join_cannot_link
from polemap.build.earlier import earlier_drives, successors_of
from polemap.build.existence import Evidence, Visibility, detection_probability, evidence, existence
from polemap.build.history import COLUMN, OldMap, open_history, write_history
from polemap.build.lines.merge_lines import merge_lines
from polemap.build.map_columns import (
    PARTS_COLUMN,
    building_reports,
    distinct,
    evidence_columns,
    facing_column,
    kind_column,
    parts_column,
    weighted,
)
from polemap.build.merge import Merged
from polemap.build.registration import NO_SHIFT, Shift, register
from polemap.build.traversals import TraversalLandmarks
from polemap.drivelog.frames import EarthFrame
from polemap.map.pole_map import FACING_COLUMN, PoleMap, join_maps

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class BuiltMap:
    """A map, and what its building found out.

    Attributes:
        removed: poles of the map before that no longer stand, or were never solid.
        shifts: correction of each drive against the others, by name.
        reports: sentences for whoever started the building.
    """

    pole_map: PoleMap
    removed: PoleMap
    shifts: dict[str, Shift]
    reports: tuple[str, ...]


def assemble_map(
    observed: Sequence[DriveObservations],
    config: MappingConfig,
    frame: EarthFrame,
    *,
    update: PoleMap | None = None,
    align: bool = False,
    run: Run = here,
    tile_m: float | None = None,
) -> BuiltMap:
    """Merge what drives observed; neither their order nor who computed them matters.

    Args:
        observed: the drives.
        config: settings.
        frame: of the map.
        update: a map to bring up to date.
        align: lay drives onto each other first.
        run: applies a function to tasks; `here`, or that of a cluster (`city.work`).
        tile_m: edge of the tiles in which the merging is done; the rows do not depend on it.
    """
    ordered = sorted(observed, key=lambda part: part.order)
    if update is not None and update.doubtful is not None:
        update = join_maps(update, update.doubtful)
    old = open_history(update) if update is not None and len(update) else None
    shifts = align_drives(ordered, old, config)
    if align:
        ordered = [part.moved(shifts[part.detections.drive]) for part in ordered]
    drifts = measure_drift(
        [part.landmarks for part in ordered],
        config,
        fixed=old.landmarks if old is not None else None,
        between=align,
    )
    if drifts is not None:
        ordered = [part.without_drift(drift) for part, drift in zip(ordered, drifts, strict=True)]
    landmarks = TraversalLandmarks.concatenate(
        [part.landmarks for part in ordered] + ([old.landmarks] if old else [])
    )
    stood = update.existence >= config.existence_min if update is not None else np.empty(0, bool)
    cannot_link = _all_cannot_link(ordered, old, stood)
    unresolved = [] if align else [shift.size_m for shift in shifts.values() if shift.significant]
    # drives that are known to disagree make the map no better than they are
    floor = float(np.sqrt(np.mean(np.square(unresolved)) / 2.0)) if unresolved else 0.0
    merged, seen = merge_tiles(
        landmarks, cannot_link, ordered, config, floor, run=run, tile_m=tile_m
    )
    evidences, said = _all_evidence(ordered, seen, old, merged, stood)
    built = _finish(ordered, landmarks, merged, evidences, old, update, config, frame)
    lines = merge_lines(ordered, config, frame, update.lines if update is not None else None)
    built = replace(built, pole_map=replace(built.pole_map, lines=lines))
    reports = building_reports(ordered, shifts, align, merged, drifts)
    reports = (*reports, said) if said is not None else reports
    if old is not None and old.moved:
        shown = ", ".join(str(name) for name in old.moved[:5])
        more = " …" if len(old.moved) > 5 else ""
        reports = (
            *reports,
            f"{len(old.moved)} poles of the old map were moved by hand ({shown}{more}): they stay "
            "where they stand now and begin a new history",
        )
    return replace(built, shifts=shifts, reports=reports)


def align_drives(
    ordered: Sequence[DriveObservations], old: OldMap | None, config: MappingConfig
) -> dict[str, Shift]:
    """The correction that lays each drive onto the map before it, or onto the earlier drives.

    The first drive (or the old map) stays where it is: which of two references is right cannot be
    told from their disagreement.
    """
    shifts: dict[str, Shift] = {}
    fixed = old.landmarks.points_m if old is not None else np.empty((0, 2))
    for part in ordered:
        points = _solid(part.landmarks, config)
        shift = register(points, fixed, config.align_max_m) if len(fixed) else NO_SHIFT
        shift = shift if shift.significant else NO_SHIFT
        shifts[part.detections.drive] = shift
        fixed = np.concatenate([fixed, shift.points(points)])
    return shifts


def _solid(landmarks: TraversalLandmarks, config: MappingConfig) -> Floats:
    return landmarks.points_m[landmarks.observations >= config.observations_min]


def _all_cannot_link(
    ordered: Sequence[DriveObservations], old: OldMap | None, stood: NDArray[np.bool_]
) -> Whole:
    parts = [part.cannot_link for part in ordered]
    lengths = [len(part.landmarks) for part in ordered]
    if old is not None:
        parts.append(_cannot_link_of_map(old, stood))
        lengths.append(len(old.landmarks))
    return join_cannot_link(parts, lengths)


def _cannot_link_of_map(old: OldMap, stood: NDArray[np.bool_]) -> Whole:
    """Neighbouring traversals that the old map held to be two standing poles stay two."""
    if not len(old.pole):
        return np.empty((0, 2), dtype=np.int64)
    pairs = (
        scipy.spatial.KDTree(old.landmarks.points_m)
        .query_pairs(2.0, output_type="ndarray")
        .reshape(-1, 2)
    )
    pairs = np.sort(pairs, axis=1)
    first, second = old.pole[pairs[:, 0]], old.pole[pairs[:, 1]]
    return np.asarray(pairs[(first != second) & stood[first] & stood[second]], dtype=np.int64)


def _all_evidence(
    ordered: Sequence[DriveObservations],
    parts: list[Visibility],
    old: OldMap | None,
    merged: Merged,
    stood: NDArray[np.bool_],
) -> tuple[list[tuple[str, float, Evidence]], str | None]:
    """What every drive, old and new, counted at every pole, in the order of time; what to say."""
    detection = detection_probability(parts)
    drives = [
        (part.detections.drive, part.detections.start_s, evidence(seen, detection))
        for part, seen in zip(ordered, parts, strict=True)
    ]
    said = None
    if old is not None:
        rows = merged.owner[sum(len(part.landmarks) for part in ordered) :]
        own = [counts for _, _, counts in drives]
        carried, said = earlier_drives(old, rows, merged.points_m, own, stood)
        drives += carried
    return sorted(drives, key=lambda drive: (drive[1], drive[0])), said


def _finish(
    ordered: Sequence[DriveObservations],
    landmarks: TraversalLandmarks,
    merged: Merged,
    drives: list[tuple[str, float, Evidence]],
    old: OldMap | None,
    update: PoleMap | None,
    config: MappingConfig,
    frame: EarthFrame,
) -> BuiltMap:
    n = len(merged)
    prior = np.zeros(n)
    old_rows = merged.owner[len(landmarks) - len(old.pole) :] if old is not None else None
    successors = successors_of(old, old_rows) if old is not None and old_rows is not None else None
    if old is not None and successors is not None:
        np.maximum.at(prior, successors[:, 1], old.prior_log_odds[successors[:, 0]])
    stands = existence([counts for _, _, counts in drives], prior)
    observations = np.bincount(merged.owner, landmarks.observations, n).astype(np.int64)
    known = np.zeros(n, dtype=bool)
    if successors is not None and update is not None:
        stood = update.existence >= config.existence_min
        known[successors[stood[successors[:, 0]], 1]] = True
    solid = known | (observations >= config.observations_min)
    ids = _ids(len(merged), successors, update)
    every = PoleMap(
        frame=frame,
        ids=ids,
        points_m=merged.points_m,
        covariance_m2=merged.covariance_m2,
        width_m=weighted(landmarks.width_m, landmarks.observations, merged.owner, n),
        height_m=weighted(landmarks.height_m, landmarks.observations, merged.owner, n),
        observations=observations,
        drives=distinct(landmarks.drive, merged.owner, n),
        existence=stands,
        extra={
            **evidence_columns(landmarks, merged.owner, drives, n),
            **kind_column(landmarks, merged.owner, n),
            **facing_column(ordered, merged.owner, _known_facing(update, successors), n),
            **parts_column(ordered, merged.owner, _known_parts(update, successors), n),
        },
    )
    # a pole that is known stays in doubt, a new one has to win it
    keep = solid & np.where(
        known, stands >= config.existence_min, stands > config.existence_min + 1e-6
    )
    # what was seen half as often as is needed may be confirmed by the next drive
    waits = (known | (observations >= max(2, config.observations_min // 2))) & ~keep
    every = _with_history(every, keep | waits, landmarks, merged.owner, drives)
    doubtful = every.rows(waits)
    just_below = np.nextafter(config.existence_min, 0.0)
    doubtful = replace(doubtful, existence=np.minimum(doubtful.existence, just_below))
    standing = replace(every.rows(keep), doubtful=doubtful)
    return BuiltMap(standing, every.rows(known & ~keep), {}, ())


def _known_facing(update: PoleMap | None, successors: Whole | None) -> dict[int, float]:
    """Free sides that the old map knew, by row of the new one."""
    if update is None or successors is None or FACING_COLUMN not in update.extra:
        return {}
    facing = update.extra[FACING_COLUMN]
    return {
        int(new): float(facing[row]) for row, new in successors.tolist() if np.isfinite(facing[row])
    }


def _known_parts(update: PoleMap | None, successors: Whole | None) -> dict[int, int]:
    """Groups of stakes that the old map knew, by row of the new one."""
    if update is None or successors is None or PARTS_COLUMN not in update.extra:
        return {}
    parts = update.extra[PARTS_COLUMN]
    return {
        int(new): int(parts[row])
        for row, new in successors.tolist()
        if np.isfinite(parts[row]) and parts[row] > 1
    }


def _with_history(
    every: PoleMap,
    wanted: NDArray[np.bool_],
    landmarks: TraversalLandmarks,
    owner: Whole,
    drives: list[tuple[str, float, Evidence]],
) -> PoleMap:
    """The map with the column `history`; empty for rows that nobody will see."""
    history = write_history(landmarks, owner, drives, wanted)
    return replace(every, extra={**every.extra, COLUMN: history})


def _ids(n: int, successors: Whole | None, update: PoleMap | None) -> Whole:
    """Poles of the old map keep their ids; new ones are numbered from south to north."""
    if successors is None or update is None:
        return np.arange(n, dtype=np.int64)
    none = np.iinfo(np.int64).max
    ids = np.full(n, none, dtype=np.int64)
    np.minimum.at(ids, successors[:, 1], update.ids[successors[:, 0]])
    fresh = ids == none
    ids[fresh] = int(update.ids.max()) + 1 + np.arange(np.count_nonzero(fresh))
    return ids
