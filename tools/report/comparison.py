"""Which of two systems is better, and whether the data can tell."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from polemap.evaluation.bootstrap import Difference, paired_difference
from polemap.evaluation.results import RouteResult, SystemResult
from polemap.tools.report.tables import Table, number, span

MEASURES = {
    "lateral_m": "lateral RMSE [m]",
    "longitudinal_m": "longitudinal RMSE [m]",
    "position_m": "position RMSE [m]",
    "yaw_rad": "yaw RMSE [rad]",
}


def compare_systems(
    results: Sequence[RouteResult], seed: int
) -> tuple[Table, list[dict[str, Any]]]:
    """Differences of every pair of localizers on every route, as a table and as values."""
    rows, values = [], []
    for result in results:
        localizers = [one for one in result.systems if one.system.kind in ("pf", "kf", "added")]
        for a, b in combinations(localizers, 2):
            if not _worth_comparing(a, b):
                continue
            for measure, found in _differences(a, b, seed):
                verdict = "–"
                if found.clear:
                    verdict = (a if found.difference < 0 else b).system.name
                rows.append(
                    (
                        result.route.name,
                        a.system.name,
                        b.system.name,
                        measure,
                        number(found.difference, 4),
                        span(found.low, found.high, 4),
                        verdict,
                    )
                )
                values.append(
                    {
                        "route": result.route.name,
                        "a": a.system.name,
                        "b": b.system.name,
                        "measure": measure,
                        "difference": found.difference,
                        "low": found.low,
                        "high": found.high,
                        "blocks": found.blocks,
                    }
                )
    table = Table(
        "comparison",
        "Comparison",
        ("Route", "A", "B", "Measure", "A − B", "95 % interval", "Better"),
        tuple(rows),
        "Paired bootstrap over blocks of 25 m of road or 5 s, and over the runs; a dash: the data "
        "cannot tell. The laps are taken as they were driven.",
        text_columns=4,
    )
    return table, values


def _worth_comparing(a: SystemResult, b: SystemResult) -> bool:
    """Particle filter with output filter of one setting, like with like of two, all with added."""
    if "added" in (a.system.kind, b.system.kind):
        return True
    return (a.system.kind == b.system.kind) != (a.system.setting == b.system.setting)


def _differences(a: SystemResult, b: SystemResult, seed: int) -> list[tuple[str, Difference]]:
    found = []
    road = paired_difference(a.blocks, b.blocks, np.random.default_rng(seed))
    if road is not None:
        found.append(("repeatability [m]", road))
    for kind, name in MEASURES.items():
        if kind in a.error_blocks and kind in b.error_blocks:
            rng = np.random.default_rng(seed)
            difference = paired_difference(a.error_blocks[kind], b.error_blocks[kind], rng)
            if difference is not None:
                found.append((name, difference))
    return found
