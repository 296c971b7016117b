"""The whole verb: files, numbers that agree with one another, bad input, and text that bites."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polemap.drivelog.tum import read_tum, tum_text
from polemap.evaluation.errors import errors_against, summary
from polemap.tools import cli
from polemap.vehicle.trajectory import Trajectory

Maker = Callable[..., Path]

EVIL = (
    "=1+1 </script><script>alert(1)</script><img src=x onerror=alert(2)>\"'&{{7*7}} $x_$ \\input{a}"
)


@pytest.fixture(scope="module")
def campus(make_runs: Maker, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_runs(tmp_path_factory.mktemp("campus"), runs=3, swerve=(2, 150.0, 2.2))


@pytest.fixture(scope="module")
def report(campus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("report")
    assert cli.run(["report", str(campus), "--out", str(out), "--latex"]) == cli.GOOD
    return out


def test_where_the_truth_is_known_accuracy_stands_before_repeatability(
    report: Path, make_runs: Maker, tmp_path: Path
) -> None:
    page = (report / "report.html").read_text()
    assert page.index("Lateral RMSE [m]") < page.index(">Repeatability")
    runs = make_runs(tmp_path / "yard", runs=1, laps=2, with_truth=False)
    assert cli.run(["report", str(runs), "--out", str(tmp_path / "report")]) == cli.GOOD
    page = (tmp_path / "report" / "report.html").read_text()
    assert page.index(">Repeatability") < page.index("Lateral RMSE [m]")


def test_files_and_contract(report: Path) -> None:
    content = json.loads((report / "report.json").read_text())
    entry = content["repeatability"]["synthetic"]
    assert {"pf_m", "kf_m", "reference_m", "laps", "runs"} <= entry.keys()
    assert entry["laps"] == 6
    assert entry["runs"] == 3
    assert entry["reference_m"] > entry["kf_m"]
    assert {"timing", "accuracy", "sweeps"} <= content.keys()
    reasons = [one["reason"] for one in entry["excluded"]]
    assert any("evasive" in reason for reason in reasons)
    assert any("start-up" in reason for reason in reasons)
    names = {path.name for path in (report / "pictures").iterdir()}
    assert {"synthetic-map-picture.svg", "synthetic-map-picture.png"} <= names
    assert {name.rsplit(".", 1)[0] for name in names if name.endswith("svg")} == {
        name.rsplit(".", 1)[0] for name in names if name.endswith("png")
    }
    assert not list(report.rglob("*.part"))
    # the localizability lies on the map as a band, and stands along the way as a picture
    page = (report / "report.html").read_text()
    assert re.search(r'<g class="bound bound[012]"><path d="M[-\d.]+ [-\d.]+L', page)
    assert "synthetic-localizability-picture.svg" in names


def test_figures_agree_with_what_was_put_in(report: Path) -> None:
    """PF 0.08 m, KF 0.06 m of lateral error on a driver of 0.12 m."""
    content = json.loads((report / "report.json").read_text())
    systems = content["repeatability"]["synthetic"]["systems"]
    for name, error in (("pf", 0.08), ("kf", 0.06)):
        one = systems[name]
        assert one["true_lateral_rms_m"] == pytest.approx(error, rel=0.15)
        expected = np.hypot(systems["truth"]["mean_m"], one["true_lateral_rms_m"])
        assert one["mean_m"] == pytest.approx(expected, rel=0.15)
        assert one["low_m"] < one["mean_m"] < one["high_m"]
    accuracy = content["accuracy"]["synthetic"]
    assert accuracy["against"] == "truth"
    assert accuracy["systems"]["pf"]["longitudinal_rmse_m"] == pytest.approx(0.1, rel=0.1)
    assert accuracy["systems"]["reference"]["lateral_rmse_m"] > 0.1


def test_tables_repeat_the_numbers(report: Path) -> None:
    content = json.loads((report / "report.json").read_text())
    entry = content["repeatability"]["synthetic"]
    page = (report / "report.html").read_text()
    table = (report / "tables" / "repeatability.csv").read_text()
    latex = (report / "tables.tex").read_text()
    for text in (page, table):
        assert f"{entry['kf_m']:.3f} ±" in text
    assert f"{entry['kf_m']:.3f} $\\pm$" in latex
    assert latex.count(r"\begin{tabular}") == latex.count(r"\end{tabular}") >= 6


def test_the_written_trajectories_give_the_printed_rmse(report: Path, campus: Path) -> None:
    content = json.loads((report / "report.json").read_text())
    printed = content["accuracy"]["synthetic"]["systems"]["kf"]["per_run_position_rmse_m"][0]
    estimate = read_tum(campus / "000" / "kf.tum")
    reference = read_tum(report / "trajectories" / "synthetic-kf-reference.tum")
    assert np.isin(reference.stamp_s, estimate.stamp_s).all()
    computed = summary(errors_against(estimate, reference))["position_rmse_m"]
    assert computed == pytest.approx(printed, abs=1e-4)


@pytest.mark.skipif(shutil.which("evo_ape") is None, reason="evo_ape is not installed")
def test_evo_agrees_to_a_millimetre(report: Path, campus: Path) -> None:
    content = json.loads((report / "report.json").read_text())
    printed = content["accuracy"]["synthetic"]["systems"]["kf"]["per_run_position_rmse_m"][0]
    reference = report / "trajectories" / "synthetic-kf-reference.tum"
    answer = subprocess.run(
        ["evo_ape", "tum", str(reference), str(campus / "000" / "kf.tum")],
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert float(re.search(r"rmse\s+([\d.]+)", answer)[1]) == pytest.approx(printed, abs=1e-3)


class Tags(HTMLParser):
    """Collects what a browser would act on."""

    def __init__(self) -> None:
        super().__init__()
        self.scripts: list[str] = []
        self.handlers: list[str] = []
        self.addresses: list[str] = []
        self.tags: list[str] = []
        self._in_script = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._in_script = tag == "script"
        if tag == "script":
            self.scripts.append("")
        for name, value in attrs:
            if name.startswith("on"):
                self.handlers.append(f"{tag} {name}")
            if name in ("src", "href", "xlink:href", "action", "data"):
                self.addresses.append(value or "")

    def handle_data(self, data: str) -> None:
        if self._in_script:
            self.scripts[-1] += data

    def handle_endtag(self, tag: str) -> None:
        if tag == "script":
            self._in_script = False


def test_the_page_stands_alone(report: Path) -> None:
    page = Tags()
    text = (report / "report.html").read_text()
    page.feed(text)
    assert len(page.scripts) == 1
    assert page.handlers == []
    assert all(a.startswith(("#", "data:text/csv", "data:image/jpeg")) or a == "data:,"
               for a in page.addresses)  # fmt: skip
    assert "@import" not in text
    assert not re.search(r"url\((?!#)", text)
    identifiers = re.findall(r'\bid="([^"]+)"', text)
    assert len(identifiers) == len(set(identifiers))


def test_the_page_opens_with_the_verdict_and_its_tables_can_be_saved(report: Path) -> None:
    text = (report / "report.html").read_text()
    assert text.index('class="verdict') < text.index('id="repeatability"')
    assert "driver&#39;s wander" in text[: text.index('id="repeatability"')]
    for term in ("pf, particle filter", "kf, output filter", "real-time factor", "NIS, NEES"):
        assert f"<dt>{term}</dt>" in text
    for table in (report / "tables").glob("*.csv"):
        address = base64.b64encode(table.read_bytes()).decode()
        assert f'download="{table.name}" href="data:text/csv;base64,{address}"' in text
    # on a phone every cell stands under its column's name
    cells, labels = text.count("<td "), text.count("<td data-label=")
    assert cells == labels > 0
    # a head that is only hidden from the eye still widens the page
    assert "thead { display: none; }" in text
    assert text.count('<div class="scroll"><table>') == text.count("<table>")
    content = json.loads((report / "report.json").read_text())
    assert set(content["verdicts"]) == set(content["routes"])


def test_text_from_drives_cannot_inject(make_runs: Maker, tmp_path: Path) -> None:
    run = make_runs(tmp_path, runs=1, laps=3, drive_name=EVIL, notes=(EVIL,), with_truth=False)
    evil_track = tmp_path / "evil.tum"
    evil_track.write_text((run / "kf.tum").read_text())
    out = tmp_path / "out"
    arguments = ["report", str(run), "--out", str(out), "--latex", "--add"]
    assert cli.run([*arguments, f"<script>alert(3)</script>$e$={evil_track}"]) == cli.GOOD
    page = Tags()
    text = (out / "report.html").read_text()
    page.feed(text)
    assert len(page.scripts) == 1
    assert "alert" not in page.scripts[0]
    assert page.handlers == []
    assert "img" not in page.tags
    assert "b" in page.tags  # the captions' own
    assert "&lt;script&gt;alert(3)" in text
    assert "{{7*7}}" in text
    latex = (out / "tables.tex").read_text()
    assert r"\input{" not in latex
    for path in out.rglob("*.csv"):
        assert not re.search(r"(^|,)=", path.read_text(), re.MULTILINE)
    assert all(path.resolve().is_relative_to(out.resolve()) for path in out.rglob("*"))


def test_routes_settings_and_added_systems(make_runs: Maker, tmp_path: Path) -> None:
    """Two courses: two routes; the same drive twice: two settings; an added one is compared."""
    first = make_runs(tmp_path, "campus", runs=2, laps=4)
    other = make_runs(tmp_path, "avenue", runs=2, laps=3, seed=4, origin_m=(900.0, 50.0))
    again = tmp_path / "campus_wide"
    shutil.copytree(first, again)
    for number in range(2):
        track = read_tum(first / f"{number:03d}" / "kf.tum")
        rough = track.poses.copy()
        rough[:, :2] += np.random.default_rng(number).normal(0.0, 0.4, (len(track), 2))
        (again / f"{number:03d}" / "kf.tum").write_text(tum_text(Trajectory(track.stamp_s, rough)))
    mine = tmp_path / "mine.tum"
    mine.write_text("# somebody else's\n" + (first / "000" / "pf.tum").read_text())
    out = tmp_path / "out"
    arguments = [str(first), str(other), str(again), "--add", f"mine={mine}", "--out", str(out)]
    assert cli.run(["report", *arguments, "--exclude", "campus/200m:220m"]) == cli.GOOD
    content = json.loads((out / "report.json").read_text())
    assert set(content["repeatability"]) == {"campus [campus]", "campus [campus_wide]", "avenue"}
    found = {
        (one["a"], one["b"], one["measure"]): one
        for one in content["comparison"] if one["route"] == "campus"
    }  # fmt: skip
    worse = found["kf [campus]", "kf [campus_wide]", "lateral RMSE [m]"]
    assert worse["high"] < 0.0
    assert ("pf [campus]", "mine", "repeatability [m]") in found
    systems = content["repeatability"]["campus [campus]"]["systems"]
    assert systems["mine"]["mean_m"] == pytest.approx(systems["pf [campus]"]["per_run_m"][0])


def test_without_drive_and_map_it_says_so(make_runs: Maker, tmp_path: Path) -> None:
    run = make_runs(tmp_path, runs=1, laps=3)
    shutil.rmtree(tmp_path / "synthetic_drive")
    (tmp_path / "synthetic_map.csv").unlink()
    out = tmp_path / "out"
    assert cli.run(["report", str(run), "--out", str(out)]) == cli.GOOD
    content = json.loads((out / "report.json").read_text())
    (entry,) = content["repeatability"].values()
    assert entry["reference_m"] is None
    assert entry["judged_by"] == "kf"
    assert entry["laps"] == 3
    assert any("cannot be read any more" in note for note in content["notes"])


def test_output_counts_from_its_first_pose_on_poles(
    make_runs: Maker, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ten seconds 5 m off, by GNSS: the start stands apart in table, JSON, picture, trajectory."""
    run = make_runs(tmp_path, runs=1, laps=2)
    kf = read_tum(run / "kf.tum")
    begin = float(kf.stamp_s[0]) + 10.0
    poses = kf.poses.copy()
    poses[kf.stamp_s < begin, 0] += 5.0
    (run / "kf.tum").write_text(tum_text(Trajectory(kf.stamp_s, poses)))

    def report_to(name: str) -> tuple[dict[str, Any], str]:
        assert cli.run(["report", str(run), "--out", str(tmp_path / name)]) == cli.GOOD
        assert "settled" not in capsys.readouterr().out
        content = json.loads((tmp_path / name / "report.json").read_text())
        return content, (tmp_path / name / "report.html").read_text()

    ages = ["" if stamp < begin else "0.1" for stamp in kf.stamp_s.tolist()]
    rows = [f"{s!r},{age}" for s, age in zip(kf.stamp_s.tolist(), ages, strict=True)]
    (run / "output.csv").write_text("\n".join(["stamp_s,pose_age_s", *rows]) + "\n")
    told = report_to("told")
    metrics = json.loads((run / "metrics.json").read_text())
    metrics["on_poles_from_s"] = begin
    (run / "metrics.json").write_text(json.dumps(metrics))
    (run / "output.csv").unlink()
    for content, page in (told, report_to("stated")):
        one = content["accuracy"]["synthetic"]["systems"]["kf"]
        assert one["position_rmse_m"] < 0.2
        assert one["start_position_rmse_m"] == pytest.approx(5.0, abs=0.2)
        assert one["poses"] + one["start_poses"] == len(kf)
        assert "Start: position RMSE" in page
        assert "start_poses" not in content["accuracy"]["synthetic"]["systems"]["pf"]
    written = read_tum(tmp_path / "stated" / "trajectories" / "synthetic-kf.tum")
    assert written.stamp_s[0] == pytest.approx(begin)


def test_output_whose_poses_on_poles_begin_after_the_reference(
    make_runs: Maker, tmp_path: Path
) -> None:
    run = make_runs(tmp_path, runs=1, laps=2)
    metrics = json.loads((run / "metrics.json").read_text())
    kerbs = {"in_map": 9, "seen": 40, "matched": 30, "suspensions": 1, "suspended_share": 0.5}
    metrics["landmarks_by_kind"] = {"kerb": {**kerbs, "residual_rms_m": 0.05}}
    (run / "metrics.json").write_text(json.dumps({**metrics, "on_poles_from_s": 1e6}))
    header, *rows = (run / "health.csv").read_text().splitlines()
    names = [f"{row},{'kerb' if number > 3 else ''}" for number, row in enumerate(rows)]
    (run / "health.csv").write_text("\n".join([f"{header},lines_suspended", *names]) + "\n")
    assert cli.run(["report", str(run), "--out", str(tmp_path / "out")]) == cli.GOOD
    content = json.loads((tmp_path / "out" / "report.json").read_text())
    assert "position_rmse_m" not in content["accuracy"]["synthetic"]["systems"]["kf"]


def test_a_run_without_poles_is_told_what_to_do(
    make_runs: Maker, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = make_runs(tmp_path, runs=1, laps=2)
    config = (run / "config.yaml").read_text()
    (run / "config.yaml").write_text(re.sub(r"(?m)^map: .*$", "map: null", config))
    (run / "pf.tum").write_text("")
    assert cli.run(["report", str(run), "--out", str(tmp_path / "out")]) == cli.USER_ERROR
    error = capsys.readouterr().err
    assert "--without-poles" in error
    assert f"--add NAME={run / 'kf.tum'}" in error.replace("\n", "")
