"""The departures from the printed method, by name, and settings with some of them taken back."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from polemap.set_option import apply_set_option
from polemap.settings import Settings, read_tree

PRINTED = Path("papers/s16.yaml")
Concern = Literal["eye", "tracks", "particles", "output"]


@dataclass(frozen=True, slots=True)
class Departure:
    """Settings that belong together.

    Attributes:
        name: as it is printed.
        concern: what it changes: disparities, tracks of poles, particle filter or output filter.
        keys: settings, or sections of them, that `papers/s16.yaml` sets otherwise.
    """

    name: str
    concern: Concern
    keys: tuple[str, ...]


def _of(concern: Concern, **keys: str) -> list[Departure]:
    room = {"eye": "stereo.", "tracks": "polemap.tracking."}.get(concern, "localize.")
    return [
        Departure(name.replace("_", " "), concern, tuple(room + key for key in words.split()))
        for name, words in keys.items()
    ]


DEPARTURES = (
    *_of(
        "eye", census_window="census", penalties="penalties", paths="paths cost_weight",
        smoothing="smoothing", right_map="right_map",
    ),
    *_of("tracks", detections_of_tracks="output", disparity_error="disparity_offset_sd_px"),
    *_of(
        "particles",
        mean_or_mode="estimate",
        weight_of_position="beta_p",
        lasting_errors_stated="covariance",
        speed_noise="alpha1_speed_mps alpha1_relative",
        drift_aside="alpha5_slip_m_per_sqrt_m",
        tight_turns="tight_turn_factor",
        learned_offsets="odometry.learn_from_poses",
        learned_noise="odometry.learn_noise",
        slip="odometry.slip_rad_per_mps2 odometry.slip_sd_rad_per_mps2",
        faulty_odometry="odometry.faults",
        doubted_odometry="odometry.doubts",
        map_covariance="poles.map_covariance",
        position_floor="poles.position_floor_m",
        existence="poles.existence",
        share_of_a_scan="poles.scan_errors",
        effective_particles="poles.effective_share_min",
        fixes_weigh="gnss.particles",
        restart_by_evidence="recovery.restart",
        constellations="recovery.places",
    ),
    *_of(
        "output",
        shared_pose_errors="output.pose_errors",
        pose_floor="output.pose_floor",
        healthy_poses_alone="output.offered",
        failed_gate="output.failed_gate",
        odometry_states="output.learn_odometry",
        fixes_in_output="gnss.output",
        limited_corrections="output.limit_corrections",
    ),
)  # fmt: skip

OURS, FILTERS, ALL = "ours", "filters as printed", "as printed"
CLASSIC = "as printed, classic exploration"
_CLASSIC_KEY = "localize.recovery.exploration=classic"
TOGETHER: dict[str, tuple[Concern, ...]] = {
    "eye as printed": ("eye", "tracks"),
    "particle filter as printed": ("particles",),
    "output filter as printed": ("output",),
    FILTERS: ("particles", "output"),
    ALL: ("eye", "tracks", "particles", "output"),
    CLASSIC: ("eye", "tracks", "particles", "output"),
}
"""Cases in which all departures of some concerns are taken back."""


def case_names(concerns: Collection[Concern]) -> list[str]:
    """Cases that can differ where only these concerns do; the ends first, then one at a time."""
    whole = [n for n, of in TOGETHER.items() if set(of) & set(concerns)]
    if "eye" not in concerns and "tracks" not in concerns:
        whole = [n for n in whole if n not in (ALL, CLASSIC)]
    if "eye" not in concerns and "eye as printed" in whole:
        whole.remove("eye as printed")
    return [OURS, *reversed(whole), *(d.name for d in DEPARTURES if d.concern in concerns)]


def concern_of(case: str) -> tuple[Concern, ...]:
    """What a case changes."""
    if case == OURS:
        return ()
    if case in TOGETHER:
        return TOGETHER[case]
    return tuple(d.concern for d in DEPARTURES if d.name == case)


def settings_of(case: str) -> Settings:
    """Our settings with the departures of a case taken back.

    Raises:
        ValueError: no such case.
    """
    if case == OURS:
        return Settings()
    concerns = TOGETHER.get(case, ())
    taken = [d for d in DEPARTURES if d.name == case or d.concern in concerns]
    if not taken:
        raise ValueError(f"no case {case}; there are: {', '.join(all_cases())}")
    printed, tree = read_tree(PRINTED), dict[str, Any]()
    for key in (key for departure in taken for key in departure.keys):
        *sections, leaf = key.split(".")
        source, target = printed, tree
        for section in sections:
            source, target = source[section], target.setdefault(section, {})
        target[leaf] = source[leaf]
    if case == CLASSIC:
        apply_set_option(tree, _CLASSIC_KEY)
    return Settings.model_validate(tree)


def all_cases() -> list[str]:
    """Every case."""
    return [OURS, *TOGETHER, *(departure.name for departure in DEPARTURES)]


def printed_keys(tree: dict[str, Any] | None = None, above: str = "") -> Iterator[str]:
    """Every setting that the printed method sets."""
    for key, value in (read_tree(PRINTED) if tree is None else tree).items():
        if isinstance(value, dict):
            yield from printed_keys(value, f"{above}{key}.")
        else:
            yield above + key
