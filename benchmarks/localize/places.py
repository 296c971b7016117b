"""Cars found anywhere in cities by their poles alone: how far they drive, and how often wrongly.

    python -m benchmarks.localize.places [--cases city repeated elsewhere park cost]
        [--poles 100000] [--starts 100] [--first 10000] [--out ROWS.jsonl]

Stereo-like scans (the errors of `DetectorConfig`, 20 % missed, half of these in every scan, 10 %
false), odometry that errs, 5 % of the city changed since it was mapped. No GNSS, no heading. A
start is found when the first claimed place is right within 0.5 m and 1 degree. Cities of seeds
below 10, and starts below 10000, served to develop the method. `repeated` is a city of avenues and
planned quarters. Not timed, so `python -m benchmarks`
leaves it out; `cost` measures growth with the map.
"""

from __future__ import annotations

import json
import resource
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from benchmarks.harness import command_line
from benchmarks.localize.cities import FRAME, City, changed, make_city, motion_along, route
from benchmarks.localize.victoria_park import DRIVE, NEAR_M, NEAR_TREES, map_of, scans_of
from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.streams import OdometryStream, ReferenceStream
from polemap.localize.place.along import searches_along
from polemap.localize.place.finder import WRONG_MOST
from polemap.map.pattern_index.build import build_index
from polemap.map.pattern_index.index import PatternIndex
from polemap.map.pattern_index.io import index_file, read_index, write_index
from polemap.map.pole_map import PoleMap, join_maps
from polemap.simulate.config import DetectorConfig
from polemap.simulate.points.drive import PointScenario, sensed
from polemap.simulate.points.motion import PointMotion
from polemap.simulate.points.poles import Poles
from polemap.vehicle.pose import wrap_angle

Floats = NDArray[np.float64]

MAPPED, OTHER = 10, 11  # seeds of the cities
WAY_M, SPEED_MPS = 150.0, 8.0
MAP_SD_M, CHANGED = 0.05, 0.05
# of all poles some are never seen; of the others a scan misses as many again
NEVER_SEEN, SEEN = 0.1, 0.89
FALSE_THINGS = 0.05  # that stand there in every scan, beside those of single scans
RIGHT_M, RIGHT_DEG = 0.5, 1.0
SCENARIO = PointScenario(
    gnss=None, detector=DetectorConfig(rate_hz=8.0, detected_share=SEEN, clutter_share=0.1)
)
REPEATED = {"avenues": 0.6, "planned": 0.5}  # of a city that is all of one kind
PARK_LEFT_M = 100.0  # of the lap, from a start on


@dataclass(frozen=True, slots=True)
class Start:
    """What came of one start.

    Attributes:
        seed: of the start.
        claimed: whether a place was claimed.
        after_m: way until then, or driven in all.
        error_m, error_deg: of the claimed place.
        bound: on its being wrong, of the last search.
        ms: processor time of every search, the local map included.
    """

    seed: int
    claimed: bool
    after_m: float
    error_m: float
    error_deg: float
    bound: float
    ms: tuple[float, ...]

    @property
    def found(self) -> bool:
        """Claimed, and right."""
        return self.claimed and self.error_m <= RIGHT_M and self.error_deg <= RIGHT_DEG


def drive_through(
    city: City, seed: int
) -> tuple[tuple[Detections, ...], OdometryStream, PointMotion]:
    """Scans and odometry of a way through a city that has changed, and the true motion."""
    drive, motion = _driven(city, seed)
    assert drive.odometry is not None
    return drive.scans, drive.odometry, motion


def drive_of(city: City, seed: int) -> Drive:
    """The same as a drive, whose reference is the true motion."""
    drive, motion = _driven(city, seed)
    assert drive.odometry is not None
    stamps = drive.odometry.stamp_s
    reference = ReferenceStream(stamps, motion.at(stamps), np.full(len(stamps), np.nan))
    return replace(drive, name=f"city_{seed}", frame=FRAME, reference=reference)


def _driven(city: City, seed: int) -> tuple[Drive, PointMotion]:
    rng = np.random.default_rng([seed, 77])
    poses = route(city, WAY_M + 1.0, rng)
    low, high = poses[:, :2].min(axis=0) - 40.0, poses[:, :2].max(axis=0) + 40.0
    near = ((city.points_m > low) & (city.points_m < high)).all(axis=1)
    world = changed(City(city.points_m[near], city.width_m[near], city.nodes_m), CHANGED, rng)
    seen = np.where(rng.random(len(world)) < NEVER_SEEN, 0.0, 1.0)
    count = rng.poisson(FALSE_THINGS * len(world))
    things = Poles(
        rng.uniform(low, high, (count, 2)), rng.uniform(0.05, 0.6, count), np.ones(count)
    )
    motion = motion_along(poses, SPEED_MPS)
    return sensed(SCENARIO, motion, replace(world, visibility=seen).joined(things), rng), motion


def one_start(
    index: PatternIndex,
    scans: Sequence[Detections],
    odometry: OdometryStream,
    truth_at: Any,
    seed: int,
    since_s: float = -np.inf,
) -> Start:
    """Search until a place is claimed, and hold it against the truth."""
    spent = []
    error, claimed, after_m, bound = (np.inf, np.inf), False, 0.0, 1.0
    begin_s = process_time()
    for one in searches_along(scans, odometry, index, since_s=since_s):
        spent.append(1e3 * (process_time() - begin_s))
        after_m = one.after_m
        if one.search is not None and len(one.search.poses):
            pose, truth = one.search.poses[0], truth_at(one.stamp_s)
            off_m = float(np.hypot(*(pose[:2] - truth[:2])))
            error = (off_m, float(np.degrees(abs(wrap_angle(pose[2] - truth[2])))))
            bound = one.search.wrong_at_most
            claimed = bound <= WRONG_MOST
            if claimed:
                break
        begin_s = process_time()
    return Start(seed, claimed, after_m, *error, bound, tuple(spent))


def in_city(
    index: PatternIndex, city: City, seeds: range, out: Path | None = None
) -> Iterator[Start]:
    """Starts of a car that drives through `city` with the index of a map."""
    for seed in seeds:
        scans, odometry, motion = drive_through(city, seed)
        start = one_start(index, scans, odometry, lambda s, m=motion: m.at(s)[0], seed)
        _keep(start, out)
        yield start


def _keep(start: Start, out: Path | None) -> None:
    if out is not None:
        row = {name: getattr(start, name) for name in Start.__slots__}
        with out.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(row) + "\n")


def show(name: str, starts: Sequence[Start]) -> None:
    """Print what came of starts."""
    claims = [s for s in starts if s.claimed]
    ways = [s.after_m for s in starts if s.found]
    wrong = [s for s in claims if not s.found]
    spent = np.concatenate([s.ms for s in starts])
    print(
        f"{name}: {len(starts)} starts, {len(ways)} found, {len(wrong)} claimed wrongly "
        f"{[(s.seed, round(s.error_m, 2), round(s.error_deg, 2)) for s in wrong]}"
    )
    if ways:
        print(f"  way: median {np.median(ways):.0f} m, 95 % {np.quantile(ways, 0.95):.0f} m")
    print(f"  a search: median {np.median(spent):.0f} ms, 95 % {np.quantile(spent, 0.95):.0f} ms")
    sys.stdout.flush()


def hidden_park() -> PoleMap:
    """The trees of Victoria Park's first part, in the middle of a city of 100,000 poles."""
    trees, city = map_of("map"), make_city(100_000, MAPPED)
    middle = 0.5 * (trees.points_m.min(axis=0) + trees.points_m.max(axis=0))
    around = city.surveyed(MAP_SD_M, MAPPED, trees.frame)
    points = around.points_m - 0.5 * np.ptp(city.points_m, axis=0) + middle
    away = KDTree(trees.points_m).query(points)[0] > NEAR_M
    moved = replace(around, points_m=points, ids=around.ids + 10_000_000, _tree=None)
    return join_maps(trees, moved.rows(away))


def park(count: int, out: Path | None = None) -> list[Start]:
    """Starts along lap `test` of Victoria Park, where trees of lap `map` stand around the car.

    The last metres of the lap are left out: who starts there sees nothing more.
    """
    drive, scans = open_drive(DRIVE).lap("test"), scans_of("test")
    assert drive.reference is not None
    assert drive.odometry is not None
    reference = drive.reference
    trees = KDTree(map_of("map").points_m)
    stamps = np.array([scan.stamp_s for scan in scans])
    place = reference.at(stamps)[:, :2]
    known = np.isfinite(place).all(axis=1)
    near = trees.query_ball_point(np.nan_to_num(place), NEAR_M, return_length=True)
    way_m = np.cumsum(np.hypot(*np.diff(np.nan_to_num(place), axis=0, prepend=place[:1]).T))
    possible = stamps[known & (near >= NEAR_TREES) & (way_m[-1] - way_m >= PARK_LEFT_M)]
    index, _ = build_index(hidden_park())
    starts = []
    for number, since_s in enumerate(possible[:: max(1, len(possible) // count)][:count]):
        start = one_start(
            index, scans, drive.odometry, lambda s: reference.at(np.array([s]))[0], number, since_s
        )
        _keep(start, out)
        starts.append(start)
    return starts


def cost(poles: int) -> dict[str, float]:
    """Build (processor time), size, open, query and memory of one map's index."""
    city = make_city(poles, MAPPED)
    pole_map = city.surveyed(MAP_SD_M, MAPPED)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "city.gpkg"
        file.write_bytes(b"what a map takes to write and to open is measured elsewhere")
        begin = process_time()
        write_index(pole_map, file)
        built_s = process_time() - begin
        count, size = len(pole_map), index_file(file).stat().st_size
        del pole_map
        before_mb = _resident_mb()
        begin = perf_counter()
        index = read_index(file)
        opened_ms = 1e3 * (perf_counter() - begin)
        assert index is not None
        spent = [ms for start in in_city(index, city, range(10_000, 10_005)) for ms in start.ms]
        grown_mb = _resident_mb() - before_mb
    return {
        "poles": count, "build_s": built_s, "bytes_a_pole": size / count, "open_ms": opened_ms,
        "search_ms": float(np.median(spent)), "search_p95_ms": float(np.quantile(spent, 0.95)),
        "grown_mb": grown_mb, "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }  # fmt: skip


def _resident_mb() -> float:
    text = Path("/proc/self/statm").read_text(encoding="ascii")
    return int(text.split()[1]) * resource.getpagesize() / 2**20


def main() -> int:
    """Run the cases that are asked for."""
    asked = command_line(
        __doc__, cases=["city", "repeated", "elsewhere", "park", "cost"], poles=100_000, starts=100,
        first=10_000, out=Path(""),
    )  # fmt: skip
    out = asked.out if asked.out != Path("") else None
    seeds = range(asked.first, asked.first + asked.starts)
    if {"city", "elsewhere"} & set(asked.cases):
        city = make_city(asked.poles, MAPPED)
        index, _ = build_index(city.surveyed(MAP_SD_M, MAPPED))
        if "city" in asked.cases:
            show(f"city of {len(city)} poles", list(in_city(index, city, seeds, out)))
        if "elsewhere" in asked.cases:
            other = make_city(asked.poles, OTHER)
            show(f"in another city than {len(city)}", list(in_city(index, other, seeds, out)))
    if "repeated" in asked.cases:
        city = make_city(asked.poles, MAPPED, **REPEATED)
        index, _ = build_index(city.surveyed(MAP_SD_M, MAPPED))
        show(
            f"city of {len(city)} poles that repeats itself", list(in_city(index, city, seeds, out))
        )
    if "park" in asked.cases:
        if DRIVE.exists():
            show("Victoria Park in a city", park(asked.starts, out))
        else:
            print("skipped: the recording ../shared/data/victoria_park is not on this machine")
    if "cost" in asked.cases:
        print({name: round(value, 2) for name, value in cost(asked.poles).items()})
    return 0


if __name__ == "__main__":
    sys.exit(main())
