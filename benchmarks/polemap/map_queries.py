"""Ten million poles: index, memory, loading and radius queries, beside a scan over all of them."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.harness import summary
from polemap.drivelog.frames import EarthFrame
from polemap.map.io import read_map, write_map
from polemap.map.pole_map import PoleMap

POLES = 10_000_000
RADIUS_M = 30.0
QUERIES = 2000


def make_city(n: int = POLES, seed: int = 0) -> PoleMap:
    """Poles along the streets of a square city, 25 m apart on both sides of streets 120 m apart."""
    rng = np.random.default_rng(seed)
    per_street = int(np.sqrt(n * 120.0 / 2.0 / 25.0))
    street = rng.integers(0, max(per_street * 25 // 120, 1), n)
    along = rng.uniform(0.0, per_street * 25.0, n)
    across = street * 120.0 + rng.choice([-6.0, 6.0], n) + rng.normal(0, 0.5, n)
    flip = rng.random(n) < 0.5
    streets = np.where(flip[:, None], np.stack([along, across], 1), np.stack([across, along], 1))
    points = streets + np.array([300_000.0, 5_700_000.0])
    covariance = np.zeros((n, 2, 2))
    covariance[:, 0, 0] = covariance[:, 1, 1] = 0.0025
    return PoleMap(
        frame=EarthFrame("utm", 32633),
        ids=np.arange(n),
        points_m=points,
        covariance_m2=covariance,
        width_m=rng.uniform(0.1, 0.5, n),
        height_m=np.full(n, np.nan),
        observations=rng.integers(8, 200, n),
        drives=rng.integers(1, 9, n),
        existence=rng.uniform(0.5, 1.0, n),
    )


def run() -> dict[str, dict[str, float]]:
    """Measure; the ratio of a query is to a scan over all poles."""
    city = make_city().lean()
    results = {"map_10M_memory": {"bytes_per_pole": city.bytes_per_pole}}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "city.parquet"
        begin = time.perf_counter()
        write_map(city, path)
        results["map_10M_write_parquet"] = _once(begin)
        results["map_10M_write_parquet"]["file_mb"] = path.stat().st_size / 1e6
        loads, work = [], []
        for _ in range(3):
            begin, busy = time.perf_counter(), time.process_time()
            loaded = read_map(path)
            loads.append(time.perf_counter() - begin)
            work.append(time.process_time() - busy)
        results["map_10M_load_parquet"] = summary(loads)
        # what it costs, where others keep the processors busy
        results["map_10M_load_parquet"]["processor_ms"] = 1e3 * float(np.median(work))
        results["map_10M_memory"]["bytes_per_pole_loaded"] = loaded.bytes_per_pole
    begin = time.perf_counter()
    assert loaded.tree is not None
    results["map_10M_index"] = _once(begin)
    rng = np.random.default_rng(1)
    centres = loaded.points_m[rng.integers(0, len(loaded), QUERIES)] + rng.normal(
        0, 10, (QUERIES, 2)
    )
    times, found = [], 0
    for centre in centres:
        begin = time.perf_counter()
        found += len(loaded.within(centre, RADIUS_M))
        times.append(time.perf_counter() - begin)
    scans = []
    for centre in centres[:5]:
        begin = time.perf_counter()
        offset = loaded.points_m - centre
        np.flatnonzero(np.einsum("ij,ij->i", offset, offset) <= RADIUS_M**2)
        scans.append(time.perf_counter() - begin)
    query = summary(times)
    query["poles_found"] = found / QUERIES
    query["ratio_to_scan"] = query["median_ms"] / (1e3 * float(np.median(scans)))
    results["map_10M_query_30m"] = query
    return results


def _once(begin: float) -> dict[str, float]:
    return summary([time.perf_counter() - begin])


if __name__ == "__main__":
    import json

    print(json.dumps(run(), indent=2))
