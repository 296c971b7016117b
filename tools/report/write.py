"""The report as files: page, JSON, tables, pictures, and trajectories for other tools."""

from __future__ import annotations

import datetime
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from polemap import __version__
from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.tum import tum_text
from polemap.evaluation.results import RouteResult
from polemap.tools.background import Background
from polemap.tools.machine import describe_machine
from polemap.tools.report.comparison import compare_systems
from polemap.tools.report.document import document, document_text
from polemap.tools.report.figures import route_pictures
from polemap.tools.report.interactive_map import interactive_map
from polemap.tools.report.page import Page, Section, SettingsText, render_page
from polemap.tools.report.photos import route_photos
from polemap.tools.report.route_tables import all_tables
from polemap.tools.report.slam_section import slam_sections
from polemap.tools.report.style import Picture
from polemap.tools.report.summary import summarise
from polemap.tools.report.tables import Table, csv_text, latex_text
from polemap.vehicle.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class SweepOutput:
    """What the sweeps add to a report."""

    values: Mapping[str, Any]
    tables: tuple[Table, ...]
    pictures: tuple[Picture, ...]
    notes: tuple[str, ...]


NO_SWEEPS = SweepOutput({}, (), (), ())


def write_report(
    results: Sequence[RouteResult],
    out: Path,
    sweeps: SweepOutput = NO_SWEEPS,
    latex: bool = False,
    seed: int = 0,
    backgrounds: Sequence[Background | None] = (),
) -> dict[str, Any]:
    """Write everything under `out` and return the content of report.json.

    Args:
        backgrounds: what lies under the map of each result; nothing where none is given.
    """
    machine = describe_machine()
    made = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    comparison, differences = compare_systems(results, seed)
    tables = [*all_tables(results, machine), *([comparison] if comparison.rows else [])]
    tables += sweeps.tables
    slugs = _slugs([result.route.name for result in results])
    under = dict(zip(slugs, backgrounds or [None] * len(slugs), strict=True))
    pictures = {
        slug: route_pictures(result, slug, under[slug])
        for slug, result in zip(slugs, results, strict=True)
    }
    photos = {slug: route_photos(result, slug) for slug, result in zip(slugs, results, strict=True)}
    head = {"polemap": __version__, "made": made, "machine": machine, "seed": seed}
    content = document(results, head, differences, sweeps.values, tables)
    slam, unread = slam_sections(results)
    content["notes"] += [*sweeps.notes, *unread]
    content["built_without_reference"] = {one.map: one.summary.as_dict() for one in slam}
    summaries = summarise(results)
    content["verdicts"] = {
        one.name: {"trust": one.trust or None, "sentence": one.verdict} for one in summaries
    }
    sections = [
        Section(
            f"route-{slug}",
            result.route.name,
            interactive_map(result, under[slug]),
            # The page has a zoomable map instead of the still one.
            tuple(p for p in pictures[slug] if not p.key.endswith("map-picture")),
            tuple(_settings(result)),
            photos[slug],
        )
        for slug, result in zip(slugs, results, strict=True)
    ]
    # a repeatability has the driver in it: where the truth is known, the error stands first
    known = any(result.against == "truth" for result in results)
    heads = ("accuracy", "repeatability") if known else ("repeatability",)
    page = Page(
        title="Localization report",
        version=__version__,
        made=made,
        machine=machine,
        head_tables=tuple(t for key in heads for t in tables if t.key == key),
        tables=tuple(t for t in tables if t.key not in heads),
        pictures=sweeps.pictures,
        sections=tuple(sections),
        notes=tuple(content["notes"]),
        summaries=summaries,
        slam=slam,
    )
    tables += [table for one in slam for table in one.tables]
    _write_tables(out, tables, latex)
    drawn = [*pictures.values(), sweeps.pictures, *(one.pictures for one in slam)]
    for picture in [one for group in drawn for one in group]:
        _write_text(out / "pictures" / f"{picture.key}.svg", picture.svg)
        _write_bytes(out / "pictures" / f"{picture.key}.png", picture.png)
    for photo in [one for group in photos.values() for one in group]:
        _write_bytes(out / "pictures" / f"{photo.key}.jpg", photo.jpeg)
    for slug, result in zip(slugs, results, strict=True):
        _write_references(out / "trajectories", slug, result)
    _write_text(out / "report.json", document_text(content))
    _write_text(out / "report.html", render_page(page))
    return content


def _settings(result: RouteResult) -> list[SettingsText]:
    found = []
    for recording in result.route.recordings:
        for one in recording.settings.values():
            text = yaml.safe_dump(dict(one.config), sort_keys=False, allow_unicode=True)
            found.append(SettingsText(one.name, text))
    return found


def _write_tables(out: Path, tables: Sequence[Table], latex: bool) -> None:
    for table in tables:
        _write_text(out / "tables" / f"{table.key}.csv", csv_text(table))
    if latex:
        _write_text(out / "tables.tex", latex_text(tables))


def _write_references(folder: Path, slug: str, result: RouteResult) -> None:
    """The reference at the stamps of the first run's poses that count, so that evo pairs exactly.

    evo pairs the nearest stamps and does not interpolate: against the reference's own stamps it
    would measure the distance that the car drives in between.
    """
    for kind in ("pf", "kf"):
        one = result.of_kind(kind)
        if one is None or not result.against:
            continue
        for number, (recording, track) in enumerate(
            zip(result.route.recordings, one.system.tracks[0], strict=True)
        ):
            goal = recording.truth if result.against == "truth" else recording.reference
            if goal is None:
                continue
            poses = goal.at(track.stamp_s)
            begins = one.system.counts_from_s
            counts = track.stamp_s >= (begins[0][number] if begins else track.stamp_s[0])
            known = ((poses[:, 0] == poses[:, 0]) & counts).nonzero()[0]
            suffix = f"-{number}" if len(result.route.recordings) > 1 else ""
            name = f"{slug}{suffix}-{kind}"
            estimate = Trajectory(track.stamp_s[known], track.poses[known])
            reference = Trajectory(track.stamp_s[known], poses[known])
            _write_text(folder / f"{name}.tum", tum_text(estimate))
            _write_text(folder / f"{name}-reference.tum", tum_text(reference))


def _slugs(names: Sequence[str]) -> list[str]:
    """File names for routes: plain letters, none twice."""
    slugs: list[str] = []
    for name in names:
        base = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:40] or "route"
        slug, number = base, 2
        while slug in slugs:
            slug, number = f"{base}-{number}", number + 1
        slugs.append(slug)
    return slugs


def _write_text(path: Path, text: str) -> None:
    _write_bytes(path, text.encode("utf-8"))


def _write_bytes(path: Path, content: bytes) -> None:
    with atomic_file(path) as part:
        part.write_bytes(content)
