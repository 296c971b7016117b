"""The departures from the printed method: complete, each its own, and with a figure each."""

from __future__ import annotations

import pytest

from benchmarks.departures.cases import (
    CLASSIC,
    DEPARTURES,
    OURS,
    PRINTED,
    TOGETHER,
    all_cases,
    case_names,
    printed_keys,
    settings_of,
)
from benchmarks.departures.table import tables
from polemap.settings import Settings, load_settings


def value(settings: Settings, key: str):
    found = settings
    for part in key.split("."):
        found = getattr(found, part)
    return found


def printed_otherwise() -> set[str]:
    printed = load_settings(PRINTED)
    return {key for key in printed_keys() if value(printed, key) != value(Settings(), key)}


def test_every_setting_of_the_printed_method_belongs_to_one_departure() -> None:
    named = [key for departure in DEPARTURES for key in departure.keys]
    assert len(named) == len(set(named))
    covered = {
        key for key in printed_otherwise() for name in named if f"{key}.".startswith(f"{name}.")
    }
    assert covered == printed_otherwise()
    # and none of them names what the printed method leaves as it is
    for name in named:
        assert any(f"{key}.".startswith(f"{name}.") for key in printed_otherwise()), name


@pytest.mark.parametrize("case", [case for case in all_cases() if case != CLASSIC])
def test_a_case_changes_what_it_names_and_nothing_else(case) -> None:
    taken = {d for d in DEPARTURES if d.name == case or d.concern in TOGETHER.get(case, ())}
    printed, settings = load_settings(PRINTED), settings_of(case)
    for key in printed_otherwise():
        mine = any(f"{key}.".startswith(f"{name}.") for d in taken for name in d.keys)
        assert value(settings, key) == value(printed if mine else Settings(), key), key


def test_taken_back_together_they_are_the_printed_method() -> None:
    printed, settings = load_settings(PRINTED), settings_of("as printed")
    assert {k for k in printed_keys() if value(settings, k) != value(printed, k)} == set()
    classic = load_settings(PRINTED, ["localize.recovery.exploration=classic"])
    assert settings_of(CLASSIC).localize == classic.localize
    assert settings_of(OURS) == Settings()
    with pytest.raises(ValueError, match="no case eyes; there are: ours, "):
        settings_of("eyes")


def test_a_route_without_pictures_has_no_case_of_the_eye() -> None:
    names = case_names(("particles", "output"))
    assert "slip" in names
    assert not {"census window", "eye as printed", "as printed"} & set(names)
    assert names[0] == OURS
    assert len(names) == len(set(names))


def row(case: str, seed: int, position_m: float) -> dict:
    figures = {
        "lateral_m": position_m, "along_m": 0.0, "position_m": position_m, "yaw_deg": 0.1,
        "p95_m": 0.1, "nees": 1.0, "lost_share": 0.0,
    }  # fmt: skip
    return {"route": "suburb", "case": case, "seed": seed, "pf": figures, "kf": figures,
            "counts": {}, "cpu_ms": 2.0}  # fmt: skip


def test_the_table_pairs_seeds_and_counts_what_failed() -> None:
    rows = [row(OURS, 0, 0.1), row(OURS, 1, 0.2), row("slip", 0, 0.2), row("slip", 1, 0.4)]
    rows.append({"route": "suburb", "case": "existence", "seed": 0, "failed": "no pose"})
    (text,) = tables(rows)
    ours, slip, failed = (line for line in text.splitlines()[2:] if line)
    if not slip.startswith("| slip"):
        slip, failed = failed, slip
    assert "+0.150 (0.071)" in slip
    assert ours.startswith("| ours | 2 | 0.150, 0.000 |  |")
    assert failed.startswith("| existence | 0 of 1: no pose |")
