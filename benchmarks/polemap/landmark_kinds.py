"""Poles and corners on real drives: how many, how steady their places, and a map of them.

    python -m benchmarks.polemap.landmark_kinds [--drives 39 03 00] [--localize]

A tracked corner is put into the earth frame by the drive's reference poses in every frame that sees
it. Its places are held against their mean, weighted by the stated covariances: the normalized
squared distance, per degree of freedom, in bands of range, should be 1. Errors of a corner that
last longer than its track, and those of the poses that are alike for all its frames, do not show.
`--localize` builds a map of the odd frames and localizes with the even ones, with poles alone and
with corners; GNSS is there in the first three seconds only and, where its fixes are as good as the
reference, moved by 1.5 m an axis (standard deviation over the seeds); it ends with the last
picture. Needs the recordings; not timed as a whole, so `python -m benchmarks` leaves it out.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

import polemap
from benchmarks.harness import RECORDINGS
from polemap.build.build_map import Scan, build_map
from polemap.build.config import MappingConfig
from polemap.config import PolemapConfig
from polemap.detect.config import DetectionConfig
from polemap.detect.detection import detect
from polemap.detect.models.io import read_classifier, read_corner_classifier
from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.landmark_kind import LandmarkKind
from polemap.drivelog.odometry_choice import with_odometry
from polemap.drivelog.readers.registry import open_drive
from polemap.localize.config import LocalizeConfig
from polemap.localize.replay import replay
from polemap.map.pole_map import PoleMap
from polemap.perception import scan_drive
from polemap.stereo.config import StereoConfig
from polemap.stereo.matching import DisparityPair, make_matcher
from polemap.vehicle.pose import rotation, transform_points

Floats = NDArray[np.float64]

DRIVES = {
    "39": RECORDINGS / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0039_sync",
    "03": RECORDINGS / "kitti_odometry" / "sequences" / "03",
    "00": RECORDINGS / "kitti_odometry" / "sequences" / "00",
}
BANDS_M = ((3.0, 10.0), (10.0, 15.0), (15.0, 20.0), (20.0, 30.0))
CONFIG = PolemapConfig(detection=DetectionConfig(kinds=("pole", "corner")))
POLES = PolemapConfig()
# every second frame is half the frames: a landmark is mapped from half as many on
_HALF_RATE = CONFIG.model_copy(update={"mapping": MappingConfig(observations_min=4)})
SEEDS = 10
START_S, FIX_SD_M = 3.0, 1.5
_FRAMES_MIN = 4  # of a track
_ROUNDS = 3


@dataclass(slots=True)
class Seen:
    """What the frames of a drive gave: raw scans, and milliseconds a frame without and with
    corners."""

    scans: list[Detections] = field(default_factory=list)
    poles_ms: list[float] = field(default_factory=list)
    both_ms: list[float] = field(default_factory=list)


def look(drive: Drive) -> Seen:
    """Match and detect every frame, and take the time of detecting."""
    assert drive.rig is not None
    cv2.setNumThreads(1)
    matcher = make_matcher(StereoConfig(), drive.rig)
    models = read_classifier("default"), read_corner_classifier("corners")
    seen = Seen()
    for row in range(len(drive.frame_stamps_s)):
        frame = drive.read_frame(row)
        disparity: DisparityPair = matcher.match(frame.left, frame.right)
        best = {"poles": np.inf, "both": np.inf}
        for _ in range(_ROUNDS):
            for name, config in (("poles", POLES.detection), ("both", CONFIG.detection)):
                begin = time.process_time()
                view = detect(frame, disparity, drive.rig, models[0], config, models[1])
                best[name] = min(best[name], time.process_time() - begin)
        seen.scans.append(view.landmarks)
        seen.poles_ms.append(1e3 * best["poles"])
        seen.both_ms.append(1e3 * best["both"])
    return seen


def _scanned(drive: Drive, scans: list[Detections], config: PolemapConfig) -> list[Detections]:
    return scan_drive(replace(drive, images=None, scans=tuple(scans)), config, raw_stereo=True)


def steadiness(drive: Drive, scans: list[Detections], kind: LandmarkKind) -> Iterator[str]:
    """Spread of tracked landmarks over the frames that see them, against what is stated."""
    assert drive.reference is not None
    places, spreads, ranges = defaultdict(list), defaultdict(list), defaultdict(list)
    for scan in scans:
        pose = drive.reference.at(np.array([scan.stamp_s]))[0]
        if not np.isfinite(pose).all():
            continue
        mine = scan.of_kinds(kind)
        turn = rotation(pose[2])
        points = transform_points(pose, mine.points_vehicle_m)
        for row, track in enumerate(mine.track_id.tolist()):
            places[track].append(points[row])
            spreads[track].append(turn @ mine.covariance_m2[row] @ turn.T)
            ranges[track].append(np.hypot(*mine.points_vehicle_m[row]))
    rows = []
    for track, at in places.items():
        if len(at) < _FRAMES_MIN:
            continue
        weight = np.linalg.inv(np.array(spreads[track]))
        total = weight.sum(axis=0)
        middle = np.linalg.solve(total, np.einsum("nij,nj->i", weight, np.array(at)))
        off = np.array(at) - middle
        squared = np.einsum("ni,nij,nj->n", off, weight, off)
        # one place is fitted: the frames share n - 1 degrees of freedom in each direction
        share = 1.0 - np.einsum("nij,ji->n", weight, np.linalg.inv(total)) / 2.0
        rows += list(zip(ranges[track], squared, 2.0 * share, np.hypot(*off.T), strict=True))
    table = np.array(rows).reshape(-1, 4)
    for low, high in (*BANDS_M, (BANDS_M[0][0], BANDS_M[-1][1])):
        inside = table[(table[:, 0] >= low) & (table[:, 0] < high)]
        if len(inside):
            nees = inside[:, 1].sum() / inside[:, 2].sum()
            yield (
                f"{kind.name.lower()} {low:g}-{high:g} m: {len(inside)} places, spread "
                f"{np.median(inside[:, 3]):.3f} m (median), NEES per degree of freedom {nees:.2f}"
            )


def _given(scans: list[Detections]) -> Scan:
    """Scans that are there already, as `build_map` asks for them."""
    return lambda _: scans


def localized(drive: Drive, raw: list[Detections]) -> Iterator[str]:
    """A map of the odd frames, and the even frames localized in it, with and without corners."""
    # a recording may go on after its last picture: what dead reckoning does there says nothing
    drive = drive.between(raw[0].stamp_s, np.nextafter(raw[-1].stamp_s, np.inf))
    gnss = drive.gnss
    if gnss is not None:  # for the start alone: these drives' fixes are as good as the reference
        gnss = gnss.take(gnss.stamp_s <= gnss.stamp_s[0] + START_S)
    blind = replace(drive, gnss=gnss)
    yield f"no map: {_accuracy(blind, drive, None, [])}"
    for name, kinds in (("poles", [0]), ("poles and corners", [0, 1])):
        mine = [scan.of_kinds(*kinds) for scan in raw]
        odd, even = (_scanned(drive, mine[first::2], CONFIG) for first in (1, 0))
        pole_map = build_map([drive], _HALF_RATE, _given(odd)).pole_map
        if not len(pole_map):
            yield f"{name}: the map holds none"
            continue
        rows = np.bincount(pole_map.kind, minlength=2)
        figures = _accuracy(blind, drive, pole_map, even)
        yield f"{name}: map of {rows[0]} poles, {rows[1]} corners: {figures}"


def _moved(drive: Drive, rng: np.random.Generator) -> Drive:
    """With all fixes moved alike, unless they were derived with an error of their own."""
    if drive.gnss is None or drive.name != DRIVES["39"].name:
        return drive
    east_m, north_m = rng.normal(0.0, FIX_SD_M, 2)
    gnss = drive.gnss
    gnss = gnss.with_columns(east_m=gnss.east_m + east_m, north_m=gnss.north_m + north_m)
    return replace(drive, gnss=gnss)


def _accuracy(blind: Drive, drive: Drive, pole_map: PoleMap | None, scans: list[Detections]) -> str:
    """Errors of the output, means over the seeds."""
    runs = []
    for seed in range(SEEDS):
        moved = _moved(blind, np.random.default_rng([seed, 31]))
        runs.append(replay(moved, pole_map, scans, LocalizeConfig(), seed=seed))
    figures = [polemap.evaluate(run, drive) for run in runs]
    lateral, along, p95, nees = (
        np.mean([getattr(one, key) for one in figures])
        for key in ("lateral_rmse_m", "longitudinal_rmse_m", "position_p95_m", "nees_mean")
    )
    return (
        f"lateral {lateral:.3f}, along {along:.3f}, p95 {p95:.3f} m, NEES {nees:.2f} "
        f"({SEEDS} seeds)"
    )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", nargs="*", default=list(DRIVES), choices=list(DRIVES))
    parser.add_argument("--localize", action="store_true")
    options = parser.parse_args()
    for name in options.drives:
        drive = with_odometry(open_drive(DRIVES[name]), "auto")
        seen = look(drive)
        sure = [
            scan.take(scan.probability >= CONFIG.detection.probability_min) for scan in seen.scans
        ]
        tracked = _scanned(drive, seen.scans, CONFIG)
        print(f"## {name}: {len(sure)} frames")
        for kind in (LandmarkKind.POLE, LandmarkKind.CORNER):
            raw, kept = (
                np.mean([len(scan.of_kinds(kind)) for scan in scans]) for scans in (sure, tracked)
            )
            print(f"{kind.name.lower()}: {raw:.2f} a frame, {kept:.2f} of confirmed tracks")
            for line in steadiness(drive, tracked, kind):
                print("  " + line)
        more = np.array(seen.both_ms) - np.array(seen.poles_ms)
        print(
            f"processor time a frame, medians: {np.median(seen.poles_ms):.2f} ms without corners, "
            f"{np.median(more):.2f} ms more with them (p95 {np.percentile(more, 95):.2f})"
        )
        if options.localize:
            for line in localized(drive, seen.scans):
                print(line)


if __name__ == "__main__":
    main()
