"""The stakes round a sapling as one landmark of a scan."""

from __future__ import annotations

import numpy as np

from polemap.drivelog.detections import Detections
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.stake_groups import MIDDLE_SD_SHARE, STAKES_MIN, diameter_m, stake_groups
from polemap.track.tracks import Tracks


def group_stakes(scan: Detections, tracks: Tracks) -> Detections:
    """The scan with one row for the stakes round one sapling, where the tracks tell of some.

    Where the middle lies to each stake is taken from the tracks, so that it does not jump when a
    stake is missed. The errors of the stakes have most in common (the disparities'), so that the
    middle is no better known than one of them.

    Args:
        scan: of tracked detections.
        tracks: confirmed ones of this moment.
    """
    poles = tracks.take(tracks.kind == LandmarkKind.POLE)
    if len(poles) < STAKES_MIN:
        return scan
    two = ~np.eye(len(poles), dtype=bool)  # tracks of one moment are different things
    label = stake_groups(poles.points_vehicle_m, poles.width_m, poles.height_m, two)
    for group in range(label.max(initial=-1) + 1):
        scan = _joined(scan, poles.take(label == group))
    return scan


def _joined(scan: Detections, stakes: Tracks) -> Detections:
    """The scan with the rows of these stakes as one."""
    mine = np.flatnonzero(np.isin(scan.track_id, stakes.ids))
    if not len(mine):
        return scan
    order = np.argsort(stakes.ids)
    at = order[np.searchsorted(stakes.ids[order], scan.track_id[mine])]
    to_middle = stakes.points_vehicle_m.mean(axis=0) - stakes.points_vehicle_m[at]
    width = diameter_m(stakes.points_vehicle_m, stakes.width_m)
    first = mine[:1]
    covariance = scan.covariance_m2[mine].mean(axis=0) + (MIDDLE_SD_SHARE * width) ** 2 * np.eye(2)
    row = scan.take(first).with_columns(
        points_vehicle_m=(scan.points_vehicle_m[mine] + to_middle).mean(axis=0)[None],
        covariance_m2=covariance[None],
        width_m=np.array([width]),
        height_m=np.array([np.nanmax(stakes.height_m)]),
        probability=np.array([scan.probability[mine].max()]),
        track_id=np.array([stakes.ids.min()]),
        parts=np.array([len(stakes)]),
    )
    rest = np.setdiff1d(np.arange(len(scan)), mine)
    return Detections.concatenate([scan.take(rest), row])
