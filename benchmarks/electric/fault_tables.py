"""The tables of the faults' benchmark, Markdown, of whatever rows there are."""

from __future__ import annotations

from collections.abc import Iterable
from statistics import median
from typing import Any

Row = dict[str, Any]


def tables(rows: list[Row]) -> str:
    """All tables that the rows `{table, of, fault, seed, ...}` fill, each with its n."""
    by_table: dict[str, list[Row]] = {}
    for row in rows:
        by_table.setdefault(row["table"], []).append(row)
    parts = [
        make(by_table[name])
        for name, make in (
            ("peaks", _peaks), ("accusations", _accusations), ("alarms", _alarms),
            ("recorded", _recorded),
        )
        if name in by_table
    ]  # fmt: skip
    return "\n\n".join(parts)


def _peaks(rows: list[Row]) -> str:
    """Median of the largest errors, gates alone → with isolation, and (its largest)."""
    of: dict[str, list[Row]] = {}
    for row in rows:
        of.setdefault(f"{row['of']} {row['fault']}", []).append(row)
    lines = [
        _line("", of),
        _line("---", ("---" for _ in of)),
        _line("found, of", (f"{len(_times(cases))} of {len(cases)}" for cases in of.values())),
        _line("after, s", (_after(cases, "{:.2g} ({:.2g})") for cases in of.values())),
    ]
    for name in rows[0]["deg"]:
        cells = []
        for cases in of.values():
            both = [[row["deg"][name][k] for row in cases] for k in (0, 1)]
            cells.append(f"{median(both[0]):.1f} → {median(both[1]):.1f} ({max(both[1]):.1f})")
        lines.append(_line(f"`{name}`", cells))
    gained = [
        (alone, isolated)
        for row in rows
        for name, (alone, isolated) in row["deg"].items()
        if name != "kinematic"
    ]
    less = sum(isolated < 0.9 * alone for alone, isolated in gained) / len(gained)
    more = [isolated - alone for alone, isolated in gained if isolated > 1.1 * alone]
    lines.append(
        f"\n{len(gained)} single runs beyond `kinematic`: a tenth less and better in {less:.1%}, a "
        f"tenth more and worse in {len(more) / len(gained):.1%}, by {max(more, default=0.0):.1f} "
        f"degrees at most; sound sensors accused in {sum(bool(row['wrong']) for row in rows)} of "
        f"{len(rows)}"
    )
    return "\n".join(lines)


def _accusations(rows: list[Row]) -> str:
    sensors, kinds = (list(dict.fromkeys(row[name] for row in rows)) for name in ("of", "fault"))
    lines = [_line("", kinds), _line("---", ("---" for _ in kinds))]
    for sensor in sensors:
        cells = []
        for kind in kinds:
            cases = [row for row in rows if (row["of"], row["fault"]) == (sensor, kind)]
            cells.append(f"{len(_times(cases))} of {len(cases)} ({_after(cases, '{:.1f}')})")
        lines.append(_line(sensor, cells))
    wrong = sum(bool(row["wrong"]) for row in rows)
    pairs = sum(bool(row["pairs"]) for row in rows)
    lines.append(
        f"\n{len(_times(rows))} of {len(rows)} found; a sound sensor accused in {wrong}, a pair "
        f"named in {pairs}"
    )
    return "\n".join(lines)


def _alarms(rows: list[Row]) -> str:
    hours = sum(float(row["fault"]) for row in rows) / 60.0
    told = [name for row in rows for name in row["accused"]]
    withheld = sum(len(row["withheld"]) for row in rows)
    return (
        f"False alarms: {len(told) / hours:.2g} an hour, {withheld / hours:.2g} of them withheld "
        f"({len(rows)} clean drives, {hours:.2g} hours) {', '.join(told)}".rstrip()
    )


def _recorded(rows: list[Row]) -> str:
    return "\n".join(
        f"{row['of']}, {3600.0 * row['hours']:.0f} s: {'; '.join(row['accused'] or ['nobody'])}"
        for row in rows
    )


def _times(rows: Iterable[Row]) -> list[float]:
    return [row["after_s"] for row in rows if row["after_s"] is not None]


def _after(rows: list[Row], form: str) -> str:
    """Median and longest time to find."""
    times = _times(rows)
    return form.format(median(times), max(times)) if times else "-"


def _line(first: str, cells: Iterable[str]) -> str:
    return f"| {first} | " + " | ".join(cells) + " |"
