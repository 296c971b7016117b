"""What a city costs as it grows: writing, index, opening, finding the car, localizing, memory.

    python -m benchmarks.localize.city_growth [--poles 1000 ... 10000000] [--starts 30]
        [--folder FOLDER] [--figures benchmarks/localize/city_growth.jsonl]
        [--picture docs/pictures/city_growth.svg]

`make city` runs it up to a million poles; ten millions take half an hour and 4 GB. The figures of a
size take the place of its last ones in the file of figures; of all that stand there the curves are
drawn (`--poles 0` measures nothing and draws). Each step is a
process of its own, so that its memory is its own: the city is made and written by tiles; its index
is built from the file; the file is opened; cars start at random places, know neither place nor
heading, and search (processor time a search, as in `places`); a drive through the middle is
localized, and its update held against that in the 200 poles around (`city_window`). With --folder
maps are kept, and used again. Not timed, so `python -m benchmarks` leaves it out.
"""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import Any

import numpy as np

from benchmarks.harness import apart, command_line
from benchmarks.localize.city_drives import drive
from benchmarks.localize.city_window import localizing, opening, resident_mb, updates
from polemap.map.city.io import open_map
from polemap.map.pattern_index.io import index_file, read_index, write_index

FIRST_START = 21_000
FIGURES = Path(__file__).with_suffix(".jsonl")
PICTURE = Path(__file__).parents[2] / "docs" / "pictures" / "city_growth.svg"
COLUMNS = {
    "poles": "poles", "write_s": "writing, s", "index_s": "index, s", "index_mb": "peak, MB",
    "bytes_a_pole": "bytes a pole", "open_ms": "open map, ms", "open_index_ms": "open index, ms",
    "search_ms": "search median", "search_p95_ms": "95 %, ms", "found": "found",
    "wrong": "wrong", "way_m": "way, m", "search_mb": "grown by, MB", "peak_mb": "localizing, MB",
    "update_ratio": "update ratio",
}  # fmt: skip


def written(poles: int, path: Path) -> dict[str, float]:
    """Make a city and write its map."""
    # imported here: the process that localizes is to hold what localizing needs
    from benchmarks.localize.cities import make_city
    from benchmarks.localize.places import MAP_SD_M, MAPPED
    from polemap.map.city.parquet.io import write_tiles

    pole_map = make_city(poles, MAPPED).surveyed(MAP_SD_M, MAPPED)
    begin = process_time()
    write_tiles(pole_map, path)
    return {"poles": len(pole_map), "write_s": process_time() - begin}


def indexed(path: Path) -> dict[str, float]:
    """Build the index from the map's file."""
    pole_map = open_map(path)
    begin = process_time()
    write_index(pole_map, path)
    size = index_file(path).stat().st_size
    return {
        "index_s": process_time() - begin,
        "index_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "bytes_a_pole": size / len(pole_map),
    }


def searched(poles: int, path: Path, starts: int) -> dict[str, float]:
    """Open the index and start anywhere."""
    from benchmarks.localize.cities import make_city
    from benchmarks.localize.places import MAPPED, in_city

    city = make_city(poles, MAPPED)
    before_mb = resident_mb()
    opened_ms = []
    for _ in range(9):
        begin = perf_counter()
        index = read_index(path)
        opened_ms.append(1e3 * (perf_counter() - begin))
    assert index is not None
    seeds = range(FIRST_START, FIRST_START + starts)
    made = list(in_city(index, city, seeds))
    spent = np.concatenate([start.ms for start in made])
    ways = [start.after_m for start in made if start.found]
    return {
        "open_index_ms": float(np.median(opened_ms)),
        "search_ms": float(np.median(spent)),
        "search_p95_ms": float(np.quantile(spent, 0.95)),
        "starts": starts,
        "found": len(ways),
        "wrong": sum(start.claimed and not start.found for start in made),
        "way_m": float(np.median(ways)) if ways else np.nan,
        "search_mb": resident_mb() - before_mb,
    }


def opened(path: Path) -> dict[str, float]:
    """Median time of nine openings, each in a process of its own."""
    return {"open_ms": float(np.median([apart(opening, path)["open_ms"] for _ in range(9)]))}


def localized(path: Path) -> dict[str, float]:
    """Memory of a drive through the city, and its update's time."""
    straight, straight_start = apart(drive, path, True)
    turning, turning_start = apart(drive, path, False)
    city = apart(updates, path, turning, turning_start)["city"]
    return {
        "peak_mb": apart(localizing, path, straight, straight_start)["peak_mb"],
        "update_ratio": city["ratio_to_few"],
    }


def measure(poles: int, folder: Path, starts: int) -> dict[str, float]:
    """All figures of a city of so many poles."""
    path = folder / f"city_{poles}.parquet"
    row: dict[str, float] = {"poles": float(poles)}
    if not path.exists():
        row |= apart(written, poles, path)
    row |= apart(indexed, path)
    row |= opened(path)
    row |= apart(searched, poles, path, starts)
    row |= localized(path)
    return row


def table(rows: list[dict[str, float]]) -> str:
    """The rows as a table in Markdown."""
    lines = [" | ".join(COLUMNS.values()), "|".join(["---"] * len(COLUMNS))]
    lines += [" | ".join(_figure(row.get(name, np.nan)) for name in COLUMNS) for row in rows]
    return "\n".join(f"| {line} |" for line in lines)


def _figure(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 100 or value == round(value) else f"{value:.3g}"


def draw(rows: list[dict[str, float]], path: Path) -> None:
    """Curves of time and memory over the size of the city."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    mpl.rcParams["svg.hashsalt"] = "city_growth"  # the same figures, the same bytes
    figure = Figure(figsize=(9.5, 3.8), layout="constrained")
    times, memory = figure.subplots(1, 2)
    poles = [row["poles"] for row in rows]
    curves: list[tuple[Any, str, str, float]] = [
        (times, "index_s", "build the index", 1.0), (times, "write_s", "write the map", 1.0),
        (times, "search_p95_ms", "a search, 95 %", 1e-3),
        (times, "search_ms", "a search, median", 1e-3), (times, "open_ms", "open the map", 1e-3),
        (times, "open_index_ms", "open the index", 1e-3),
        (memory, "index_mb", "building the index", 1.0),
        (memory, "search_mb", "searching: pages of the index", 1.0),
        (memory, "peak_mb", "localizing", 1.0),
    ]  # fmt: skip
    for axes, name, label, scale in curves:
        axes.plot(poles, [row[name] * scale for row in rows], marker="o", ms=4, label=label)
    for axes, name in ((times, "seconds"), (memory, "MB")):
        axes.set(xscale="log", yscale="log", xlabel="poles of the city", ylabel=name)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)


def kept(path: Path) -> dict[int, dict[str, float]]:
    """The figures of a file, by the size that was asked for."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return {int(row["asked"]): row for row in map(json.loads, lines)}


def keep(rows: dict[int, dict[str, float]], path: Path) -> None:
    """Write figures, the smallest city first."""
    lines = [json.dumps(rows[size]) + "\n" for size in sorted(rows)]
    path.write_text("".join(lines), encoding="utf-8")


def main() -> int:
    """Measure the sizes that are asked for, and draw all that are known."""
    sizes = [0, 1000, 10_000, 100_000, 1_000_000, 10_000_000]
    asked = command_line(
        __doc__, poles=[str(size) for size in sizes], starts=30, folder=Path(""), figures=FIGURES,
        picture=PICTURE,
    )  # fmt: skip
    rows = kept(asked.figures)
    with TemporaryDirectory() as temporary:
        folder = asked.folder if asked.folder != Path("") else Path(temporary)
        for size in filter(None, map(int, asked.poles)):
            old = rows.get(size, {})
            # a map that is there already is not written again
            rows[size] = {"asked": size, "write_s": old.get("write_s", np.nan)}
            rows[size] |= measure(size, folder, asked.starts)
            print(table([rows[size]]), flush=True)
            keep(rows, asked.figures)
    print(table([rows[size] for size in sorted(rows)]))
    draw([rows[size] for size in sorted(rows)], asked.picture)
    return 0


if __name__ == "__main__":
    sys.exit(main())
