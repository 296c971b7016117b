"""How a report begins."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import InputError
from polemap.drivelog.frames import EarthFrame
from polemap.tools.report import summary as opening
from polemap.tools.report.photos import route_photos
from polemap.vehicle.trajectory import Trajectory
from tests.drivelog.drives import RIG, picture


def run_with(trust: str | None, **metrics: Any) -> Any:
    verdict = {"verdict": {"trust": trust, "sentence": f"{trust}: because", "healthy_share": 0.5}}
    return SimpleNamespace(metrics={**(verdict if trust else {}), **metrics})


def route(runs: list[Any], against: str | None = "truth") -> Any:
    return SimpleNamespace(
        route=SimpleNamespace(name="campus", setting_names=("",)),
        against=against,
        of_kind=lambda kind: None,
        runs=runs,
    )


@pytest.fixture(autouse=True)
def _runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opening, "runs_of", lambda result, _setting: [result.runs])


def test_the_worst_run_speaks() -> None:
    runs = [run_with("trustworthy"), run_with("not"), run_with("partly")]
    (one,) = opening.summarise([route(runs)])
    assert one.trust == "not"
    assert one.verdict == "Not trustworthy: because (1 of 3 runs)"


def test_figures_are_those_that_localize_prints() -> None:
    errors = {"lateral_rmse_m": 0.034, "longitudinal_rmse_m": 0.061, "yaw_rmse_rad": 0.006}
    (one,) = opening.summarise([route([run_with("trustworthy", kf=errors, real_time_factor=4.06)])])
    values = {figure.value: figure.label for figure in one.figures}
    assert list(values)[:3] == ["0.03 m", "0.06 m", "0.34°"]
    assert "against the truth" in values["0.03 m"]
    assert "seconds of driving" in values["4.1 ×"]
    (slow,) = opening.summarise([route([run_with("trustworthy", real_time_factor=0.0312)])])
    assert "0.031 ×" in {figure.value for figure in slow.figures}
    assert values["50 %"] == "of the output was called healthy"


def test_without_reference_and_verdict_both_are_said() -> None:
    (one,) = opening.summarise([route([run_with(None)], None)])
    assert one.trust == ""
    assert one.verdict.startswith("Without a verdict")
    assert "no reference" in one.figures[0].label


def test_pictures_of_a_drive_that_has_changed_are_left_out() -> None:
    class Images:
        def load(self, row: int) -> Any:
            if row > 5:
                raise InputError("gone")
            return picture(row), picture(row)

        def keep(self, rows: Any) -> Images:
            return self

    stamps = np.arange(10.0)
    drive = Drive(
        "d", None, EarthFrame("local", name="yard"), 2.7, RIG, frame_stamps_s=stamps,  # type: ignore[arg-type]
        frame_arrivals_s=stamps, frame_numbers=np.arange(10), images=Images(),
    )  # fmt: skip
    guide = Trajectory(stamps, np.zeros((10, 3)))
    recording = SimpleNamespace(drive=drive, guide=guide)
    found = SimpleNamespace(route=SimpleNamespace(recordings=[recording], pole_map=None))
    photos = route_photos(found, "campus")  # type: ignore[arg-type]
    assert [photo.key for photo in photos] == ["campus-seen-30", "campus-seen-60"]
    assert photos[0].jpeg.startswith(b"\xff\xd8")
    assert photos[0].address.startswith("data:image/jpeg;base64,")
    recording.drive = replace(drive, images=None)
    assert route_photos(found, "campus") == ()  # type: ignore[arg-type]
