"""Tables of rows: a line a case, means over the seeds, and what each departure is worth."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.departures.cases import OURS, all_cases
from benchmarks.departures.routes import ROUTES

Row = dict[str, Any]
HEAD = (
    "| {route} | seeds | particle filter: lateral, along | worth (sd) | yaw | NEES | lost "
    "| starts anew | output: lateral, along | worth (sd) | NEES | lost | ms |"
)


def tables(rows: list[Row]) -> Iterator[str]:
    """A table for every route that has rows."""
    for route in ROUTES:
        mine = [row for row in rows if row["route"] == route]
        if mine:
            lines = [HEAD.format(route=route), "|---" * 13 + "|"]
            ours = {row["seed"]: row for row in mine if row["case"] == OURS}
            for case in all_cases():
                chosen = [row for row in mine if row["case"] == case]
                if chosen:
                    lines.append(line(case, chosen, ours))
            yield "\n".join(lines)


def line(case: str, rows: list[Row], ours: dict[int, Row]) -> str:
    """Means over the seeds that came through; in front how many of how many."""
    whole = [row for row in rows if "failed" not in row]
    count = f"{len(whole)}" if len(whole) == len(rows) else f"{len(whole)} of {len(rows)}"
    if not whole:
        return f"| {case} | {count}: {rows[0]['failed']} |" + " |" * 11
    cells = [case, count]
    for name in ("pf", "kf"):
        cells.append(", ".join(f"{_mean(whole, name, k):.3f}" for k in ("lateral_m", "along_m")))
        cells.append(_worth(whole, ours, name))
        if name == "pf":
            cells.append(f"{_mean(whole, name, 'yaw_deg'):.2f}")
        cells.append(f"{_mean(whole, name, 'nees'):.2f}")
        cells.append(f"{100.0 * _mean(whole, name, 'lost_share'):.1f} %{_silent(whole, name)}")
        if name == "pf":
            again = [row["counts"].get("pf_reinitializations", 0) for row in whole]
            cells.append(f"{np.mean(again):.1f}")
    cells.append(f"{np.mean([row['cpu_ms'] for row in whole]):.1f}")
    return f"| {' | '.join(cells)} |"


def _silent(rows: list[Row], name: str) -> str:
    """Seconds a drive in which it was wrong and called healthy, where faults are in the drives."""
    seconds = [row["silent_s"][name] for row in rows if "silent_s" in row]
    return f", {np.mean(seconds):.1f} s silent" if seconds else ""


def _mean(rows: list[Row], name: str, key: str) -> float:
    return float(np.mean([row[name][key] for row in rows]))


def _worth(rows: list[Row], ours: dict[int, Row], name: str) -> str:
    """How much larger the position's error is without the departure, mean and spread, in metres."""
    paired = [(row, ours[row["seed"]]) for row in rows if row["seed"] in ours]
    more = [
        row[name]["position_m"] - own[name]["position_m"]
        for row, own in paired
        if "failed" not in own
    ]
    if not more or rows[0]["case"] == OURS:
        return ""
    spread = float(np.std(more, ddof=1)) if len(more) > 1 else float("nan")
    return f"{np.mean(more):+.3f} ({spread:.3f})"
