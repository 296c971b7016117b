"""What the size of a city costs a localizer: opening, memory, update, reading a window, the pose.

    python -m benchmarks.localize.city_window [MAP...]

`run()` makes cities of 1,000 to 100,000 poles; larger ones are made once by
`python -m benchmarks.localize.cities POLES MAP` and given here. For each map, in a process of its
own:

- `open`: time of `open_map` (the first of the process, libraries imported), and resident memory;
- `update`: of the particle filter on a circle in the city's middle, in the city and in the 200
  poles around, sample by sample in turn, so that a busy machine slows both;
- `window`: reading a square of 1200 m at places all over the city, nothing of it in memory;
- `pose`: `pose_at` asked every millisecond while another thread adds samples, with the 200 poles in
  memory, with the city as in a car, and with a thread that reads windows without a pause. In turn.
"""

from __future__ import annotations

import json
import resource
import sys
import tempfile
import time
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Figures, apart, show, summary
from benchmarks.localize.city_drives import Samples, drive, few
from polemap.localize.config import LocalizeConfig, OdometryConfig
from polemap.localize.localizer import Localizer
from polemap.localize.map_window import LOADED_M
from polemap.map.city.city_map import CityMap
from polemap.map.city.io import open_map
from polemap.map.city.tiles import box_around
from polemap.map.pole_map import PoleMap

Floats = NDArray[np.float64]

_CONFIG = LocalizeConfig(odometry=OdometryConfig(slip_rad_per_mps2=0.005))
_WHEELBASE_M = 2.7
_ROUNDS, _ROUND_S, _ASKED_S = 3, 6.0, 0.001


def _localizer(pole_map: PoleMap | CityMap, start: Floats, **options: Any) -> Localizer:
    localizer = Localizer(pole_map, _CONFIG, _WHEELBASE_M, np.random.default_rng(0), **options)
    localizer.start_at(-0.02, start, np.diag([0.04, 0.04, 1e-4]))
    return localizer


def resident_mb() -> float:
    """Of this process, now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


def opening(path: Path) -> dict[str, float]:
    """Time and memory of opening a map."""
    # an empty city has the libraries imported, which a program does once
    before = resident_mb()
    _import_libraries(path)
    imported = resident_mb()
    begin = time.perf_counter()
    pole_map = open_map(path)
    return {
        "poles": float(len(pole_map)),
        "open_ms": 1e3 * (time.perf_counter() - begin),
        "imports_mb": imported - before,
        "resident_mb": resident_mb(),
        "file_mb": path.stat().st_size / 1e6,
    }


def _import_libraries(path: Path) -> None:
    if path.suffix == ".parquet":
        from pyarrow import parquet  # noqa: F401
        from pyproj import CRS  # noqa: F401


def localizing(path: Path, samples: Samples, start: Floats) -> dict[str, float]:
    """A drive straight through the city as in a car: memory, updates, windows."""
    pole_map = open_map(path)
    localizer = _localizer(pole_map, start, clock=time.perf_counter)
    for sample in samples:
        localizer.add_sample(sample)
        localizer.pose_at(sample.arrival_s)
    counts = localizer.summary()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 * 1.048576
    return {
        **summary(localizer.timings_s["particle_filter"]),
        "windows": float(counts.get("pf_map_windows", 0)),
        "beyond_window": float(counts.get("pf_poles_beyond_window", 0)),
        "peak_mb": peak,
    }


def updates(path: Path, samples: Samples, start: Floats) -> Figures:
    """Of the particle filter in the city and in the 200 poles around, in turn."""
    pole_map = open_map(path)
    localizers = {
        "few": _localizer(few(pole_map, start), start, clock=time.perf_counter),
        "city": _localizer(
            pole_map, start, clock=time.perf_counter, load_in_background=False
        ),
    }  # fmt: skip
    for number, sample in enumerate(samples):
        for name in sorted(localizers, reverse=bool(number % 2)):
            localizers[name].add_sample(sample)
    # the first scan of a replay reads the window
    times = {name: one.timings_s["particle_filter"][5:] for name, one in localizers.items()}
    return {
        "few": summary(times["few"]),
        "city": {
            **summary(times["city"]),
            "ratio_to_few": float(np.median(times["city"]) / np.median(times["few"])),
        },
    }


def windows(path: Path, places: int = 40) -> dict[str, float]:
    """Reading windows all over the city, each from the disk."""
    first = open_map(path)
    if not isinstance(first, CityMap):
        return {}
    extent = np.array(first.statistics.extent_m).reshape(2, 2)
    rng = np.random.default_rng(0)
    spent, found = [], []
    for _ in range(places):
        city = CityMap(first._store, cached_poles=0)
        begin = time.perf_counter()
        area = city.area(box_around(rng.uniform(*extent), LOADED_M))
        _ = area.poles.tree
        spent.append(time.perf_counter() - begin)
        found.append(len(area.poles))
    return {**summary(spent), "poles": float(np.mean(found))}


def poses(path: Path, samples: Samples, start: Floats) -> Figures:
    """`pose_at` without windows, with those of a car, and with windows without a pause."""
    pole_map = open_map(path)
    maps = {"in_memory": few(pole_map, start), "city": pole_map, "always_reading": pole_map}
    spent: dict[str, list[float]] = {name: [] for name in maps}
    for _ in range(_ROUNDS):
        for name, one in maps.items():
            stop = Event()
            reading = Thread(target=_read_on, args=(pole_map, stop), daemon=True)
            if name == "always_reading":
                reading.start()
            spent[name] += _asked(_localizer(one, start), samples, stop)
            stop.set()
            if name == "always_reading":
                reading.join()
    base = float(np.percentile(spent["in_memory"], 99.9))
    return {
        name: {
            **summary(times, 99),
            "p99.9_ms": 1e3 * float(np.percentile(times, 99.9)),
            "max_ms": 1e3 * max(times),
            "p99.9_ratio_to_in_memory": float(np.percentile(times, 99.9)) / base,
        }
        for name, times in spent.items()
    }


def _read_on(pole_map: PoleMap | CityMap, stop: Event) -> None:
    if not isinstance(pole_map, CityMap):
        return
    extent = np.array(pole_map.statistics.extent_m).reshape(2, 2)
    rng = np.random.default_rng(0)
    while not stop.is_set():
        city = CityMap(pole_map._store, cached_poles=0)
        _ = city.area(box_around(rng.uniform(*extent), LOADED_M)).poles.tree


def _asked(localizer: Localizer, samples: Samples, stop: Event) -> list[float]:
    """Seconds of `pose_at` while the samples come in real time."""
    begin = time.perf_counter()

    def feed() -> None:
        for sample in samples:
            wait = sample.arrival_s - (time.perf_counter() - begin)
            if wait > 0.0:
                time.sleep(wait)
            if stop.is_set() or sample.arrival_s > _ROUND_S:
                return
            localizer.add_sample(sample)

    feeding = Thread(target=feed, daemon=True)
    feeding.start()
    spent = []
    for tick in count():
        due = tick * _ASKED_S
        wait = due - (time.perf_counter() - begin)
        if wait > 0.0:
            time.sleep(wait)
        if due > _ROUND_S:
            break
        asked = time.perf_counter()
        localizer.pose_at(asked - begin)
        spent.append(time.perf_counter() - asked)
    feeding.join()
    return spent


def measure(path: Path, *, with_poses: bool = True) -> dict[str, Any]:
    """All figures of a map."""
    turning, turning_start = apart(drive, path, False)
    straight, straight_start = apart(drive, path, True)
    figures = {
        "open": apart(opening, path),
        "localizing": apart(localizing, path, straight, straight_start),
        "update": apart(updates, path, turning, turning_start),
        "window": apart(windows, path),
    }
    if with_poses:
        figures["pose"] = apart(poses, path, turning, turning_start)
    return figures


def flat(name: str, figures: dict[str, Any]) -> Figures:
    """Rows of the figures of a map."""
    rows: Figures = {}
    for part, values in figures.items():
        if values and isinstance(next(iter(values.values())), dict):
            rows |= {f"{name}_{part}_{one}": row for one, row in values.items()}
        elif values:
            rows[f"{name}_{part}"] = values
    return rows


def run() -> Figures:
    """Cities that are made in a few seconds."""
    from benchmarks.localize.cities import make_city
    from polemap.map.io import write_map

    rows: Figures = {}
    with tempfile.TemporaryDirectory() as folder:
        for poles in (1000, 10_000, 100_000):
            path = Path(folder) / f"city_{poles}.gpkg"
            write_map(make_city(poles, 1).surveyed(0.05, 0), path)
            rows |= flat(path.stem, measure(path, with_poses=poles == 100_000))
    return rows


def main(words: Sequence[str]) -> None:
    """Measure the maps that are named, or those of `run`."""
    if not words:
        show("cities", run())
        return
    for word in words:
        path = Path(word)
        rows = flat(path.name, measure(path))
        show(path.name, rows)
        print(json.dumps(rows))


if __name__ == "__main__":
    main(sys.argv[1:])
