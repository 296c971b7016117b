"""The section on a map that was built without a reference, and the file that it comes from."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from polemap.build.slam.motion import CALIBRATION
from polemap.build.slam.report import (
    AlongRoute,
    DriveSummary,
    LoopFigures,
    SlamSummary,
    once_m,
    once_sentence,
    sentences,
)
from polemap.drivelog.errors import InputError
from polemap.tools import cli
from polemap.tools.slam_file import figures_path, read_figures, remove_figures, write_figures

Maker = Callable[..., Path]
EVIL = "taxi <script>alert(1)</script> $x_$"


def drive(name: str = EVIL, fixes: int = 4) -> DriveSummary:
    along = AlongRoute(
        way_m=(0.0, 50.0, 100.0),
        east_m=(500010.0, 500060.0, 500110.0),
        north_m=(4.0, 5.0, 6.0),
        absolute_sd_m=(0.5, 0.6, 0.7),
        relative_sd_m=(0.05, 0.06, 0.07),
        fix_way_m=(1.0, 20.0, 40.0, 60.0)[:fixes],
        fix_residual_m=(1.0, 2.0, 1.5, 900.0)[:fixes],
        fix_weight=(1.0, 0.9, 0.8, 0.0)[:fixes],
    )
    off = 1.7 if fixes else float("nan")
    found = dict.fromkeys(CALIBRATION, 0.01)
    return DriveSummary(name, 100.0, fixes, 1, off, (0.6, 0.7), (0.06, 0.07), found, along)


def summary(*drives: DriveSummary) -> SlamSummary:
    names = [part.drive for part in drives]
    places = (
        LoopFigures(names[0], 10.0, names[-1], 90.0, 5, 12.5, 2.0, taken_back=False),
        LoopFigures(names[0], 20.0, names[-1], 70.0, 3, 9.0, 40.0, taken_back=True),
    )
    absolute = any(part.fixes for part in drives)
    return SlamSummary(drives, 1, 1, 2, 0.08, 40, 3, 1.4, 30.0, absolute, places)


def put(folder: Path, *drives: DriveSummary) -> Path:
    place = folder / "street.csv"
    place.write_text("east_m,north_m\n1,2\n")
    write_figures(place, summary(*drives))
    return place


def test_figures_come_back_as_they_were_written(tmp_path: Path) -> None:
    place = put(tmp_path, drive(), drive("van", fixes=0))
    found = read_figures(place)
    assert found is not None
    assert found.is_of_this_map
    assert found.summary.drives[0] == drive()
    assert found.summary.drives[1].fix_residual_m != found.summary.drives[1].fix_residual_m
    place.write_text("east_m,north_m\n1,3\n")
    changed = read_figures(place)
    assert changed is not None
    assert not changed.is_of_this_map
    assert read_figures(tmp_path / "other.csv") is None


def test_way_seen_once_is_told_apart_from_what_loops_vouch_for() -> None:
    """An arm's fixes may be wrong alike, which no stated deviation knows of."""
    way = tuple(float(at) for at in range(0, 401, 10))
    same = (0.5,) * len(way)
    arm = replace(drive(), way_m=400.0, along=AlongRoute(way, way, way, same, same, (), (), ()))
    looped = summary(arm)  # from 10 m on the way to 90 m; another loop was taken back
    assert once_m(looped) == pytest.approx(10.0 + 275.0, abs=6.0)
    assert "of 400 m were seen once only" in (once_sentence(looped) or "")
    assert any("were seen once only" in line for line in sentences(looped))
    # without loops all of it, without fixes the earth is not spoken of
    assert once_m(replace(looped, places=())) == pytest.approx(400.0)
    assert once_sentence(replace(looped, absolute=False)) is None
    near = (replace(looped.places[0], second_way_m=35.0), looped.places[0])
    assert once_sentence(replace(summary(drive()), places=near)) is None
    nothing = replace(drive(), along=AlongRoute((0.0,), (0.0,), (0.0,), (1.0,), (1.0,), (), (), ()))
    assert once_m(summary(nothing)) == 0.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "street.slam.json: not JSON"),
        ("[]", "no figures of a map"),
        ('{"format_version": 2}', "format_version 2 is not 1"),
        ('{"format_version": 1, "drives": [{"drive": 3}]}', r"street.slam.json: drives\.0"),
    ],
)
def test_damaged_figures_are_one_line(tmp_path: Path, text: str, said: str) -> None:
    place = put(tmp_path, drive())
    figures_path(place).write_text(text)
    with pytest.raises(InputError, match=said):
        read_figures(place)
    remove_figures(place)
    assert figures_path(place).exists()


def test_figures_of_an_earlier_map_go(tmp_path: Path) -> None:
    place = put(tmp_path, drive())
    remove_figures(place)
    assert not figures_path(place).exists()
    remove_figures(place)


def test_the_page_has_a_section(make_runs: Maker, tmp_path: Path) -> None:
    runs = make_runs(tmp_path / "runs", runs=1, laps=2)
    config = next(iter(runs.rglob("config.yaml")))
    place = Path(yaml.safe_load(config.read_text())["map"])
    write_figures(place, summary(drive(), drive("van", fixes=0)))
    out = tmp_path / "report"
    assert cli.run(["report", str(runs), "--out", str(out)]) == cli.GOOD
    page = (out / "report.html").read_text()
    assert f"Built without reference: {place.name}" in page
    assert page.count("<script") == 1
    assert "Loops that were taken back" in page
    text = re.sub(r"<[^>]+>", " ", page)
    assert "1 places were seen again" not in text
    assert "to the earth 0.60 m" in text
    content = json.loads((out / "report.json").read_text())
    assert content["built_without_reference"][place.name]["loops"] == 1
    assert {p.name for p in (out / "pictures").glob("slam-1-*.svg")} == {
        "slam-1-loops.svg", "slam-1-expected.svg", "slam-1-fixes.svg",
    }  # fmt: skip
    # a map that was edited since, and figures that cannot be read
    write_figures(place, replace(summary(drive(fixes=0)), places=()))
    with place.open("a") as stream:
        stream.write("\n")
    assert cli.run(["report", str(runs), "--out", str(out)]) == cli.GOOD
    page = (out / "report.html").read_text()
    assert "has been changed since" in page
    assert "no drive has a fix" in page
    figures_path(place).write_text("{")
    assert cli.run(["report", str(runs), "--out", str(out)]) == cli.GOOD
    page = (out / "report.html").read_text()
    assert "how the map was built is not shown" in page
