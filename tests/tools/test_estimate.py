"""`polemap estimate` on small logs, its formats and its complaints, and on the real racing car."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.electric import fault_drives
from polemap.electric.config import EstimatorConfig
from polemap.electric.studies.scenes import Scene, drive_with_camera
from polemap.tools.cli import run
from polemap.vehicle.io import dump_car, load_car
from tests.electric.driven import driven


@pytest.fixture
def log(tmp_path: Path) -> Path:
    config = EstimatorConfig(step_s=0.003)
    scene = Scene(7.0, 4.0, 0.05, 0.5, model_noise=False)
    drive = drive_with_camera(load_car("coms"), scene, config, np.random.default_rng(0))
    table = pd.DataFrame({"stamp_s": drive.log.stamp_s, **drive.log.columns})
    table["sideslip_rad"] = drive.truth[:, 0]
    table["cabin_temperature"] = 21.0
    table.to_csv(tmp_path / "log.csv", index=False)
    return tmp_path / "log.csv"


def arguments(log: Path, *more: str) -> list[str]:
    return ["estimate", str(log), "--vehicle", "coms", "--out", str(log.parent / "out.csv"), *more]


def test_estimates_scores_and_says_what_it_ignored(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments(log, "--estimator", "clones")) == 0
    said = capsys.readouterr()
    line = json.loads(said.out)
    assert line["estimator"] == "clones"
    assert line["sideslip_rmse_deg"] < line["sideslip_p95_deg"] < 0.5
    assert "cabin_temperature" in said.err
    out = pd.read_csv(log.parent / "out.csv")
    assert {"stamp_s", "sideslip_rad", "sideslip_sd_rad", "lateral_offset_sd_m"} <= set(out.columns)


def test_parquet_with_other_names_gives_the_same(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments(log, "--estimator", "bicycle")) == 0
    first = capsys.readouterr().out
    table = pd.read_csv(log)
    table["speed_kmh"] = table.pop("vx_mps") * 3.6
    table.rename(columns={"yaw_rate_radps": "gyro"}).to_parquet(log.with_suffix(".parquet"))
    mapping = log.parent / "names.yaml"
    mapping.write_text(f"yaw_rate_radps: gyro\nvx_mps: {{column: speed_kmh, scale: {1 / 3.6!r}}}\n")
    more = ("--estimator", "bicycle", "--mapping", str(mapping))
    assert run(arguments(log.with_suffix(".parquet"), *more)) == 0
    assert capsys.readouterr().out == first


def test_identify_finds_the_plant_and_writes_a_car(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = log.parent / "mine.yaml"
    soft = log.parent / "soft.yaml"
    soft.write_text(dump_car(load_car("coms").scaled(stiffness=0.6)))
    call = ["estimate", str(log), "--vehicle", str(soft), "--identify", "0:4", "--out", str(out)]
    assert run(call) == 0
    car = load_car(out)
    assert car.front_stiffness_nprad == pytest.approx(6000.0, rel=0.05)
    assert car.rear_stiffness_nprad == pytest.approx(6000.0, rel=0.05)
    assert "--identify 0:4" in car.source
    assert json.loads(capsys.readouterr().out)["car"] == "mine"


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--estimator", "oracle"), "choose one of"),
        (("--estimator", "two_layer"), "two_layer needs gps"),
        (
            ("--estimator", "bicycle", "--set", "gyro_sd=1"),
            "unknown key 'gyro_sd'; known here: step_s",
        ),
        (("--estimator", "bicycle", "--set", "gyro_sd_radps=[1"), "the value is not YAML"),
        (("--estimator", "bicycle", "--set", "gyro_sd_radps"), "expected key=value"),
        (("--estimator", "bicycle", "--set", "gyro_sd_radps=-1"), "greater than 0"),
        (("--estimator", "bicycle", "--span", "9:7"), "two stamps"),
        (("--estimator", "bicycle", "--span", "90:95"), "the log runs from"),
        (("--identify", "0:4"), "name it NAME.yaml"),
        (("--estimator", "bicycle", "--config", "nowhere.yaml"), "cannot be read"),
    ],
)
def test_user_errors_are_one_line(
    log: Path, capsys: pytest.CaptureFixture[str], more: tuple[str, ...], message: str
) -> None:
    assert run(arguments(log, *more)) == 2
    said = capsys.readouterr()
    assert message in said.err
    assert not (log.parent / "out.csv").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.assign(stamp_s=t.stamp_s[::-1].to_numpy()), "does not follow"),
        (lambda t: t.drop(columns="stamp_s"), "no column stamp_s"),
        (lambda t: t.assign(vx_mps=["fast"] + ["7"] * (len(t) - 1)), "row 2, vx_mps: 'fast'"),
        (lambda t: t.assign(vx_mps=np.inf), "infinite"),
        (lambda t: t[:1], "two rows"),
    ],
)
def test_bad_logs_name_the_place(
    log: Path,
    capsys: pytest.CaptureFixture[str],
    change: Callable[[pd.DataFrame], pd.DataFrame],
    message: str,
) -> None:
    change(pd.read_csv(log)).to_csv(log, index=False)
    assert run(arguments(log, "--estimator", "bicycle")) == 2
    assert message in capsys.readouterr().err


def test_list_names_estimators_and_cars(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["estimate", "--list"]) == 0
    said = capsys.readouterr().out
    assert "two_layer" in said
    assert "250lm" in said


@pytest.mark.slow
def test_racing_car_with_true_side_slip(
    recording: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = recording("revs_250lm") / "signals.csv.gz"
    settings = tmp_path / "s.yaml"
    settings.write_text(
        "gyro_sd_radps: 0.01\ncourse_sd_rad: 0.005\nsideslip_walk_rad: 0.01\n"
        "yaw_rate_walk_radps: 0.2\nsideslip_disturbance_radps: 0.05\nyaw_disturbance_radps2: 0.5\n"
    )
    errors = {}
    for name in ("bicycle", "two_layer", "nonlinear"):
        call = ["estimate", str(source), "--estimator", name, "--vehicle", "250lm", "--derive-gps"]
        call += ["--span", "250:450", "--config", str(settings), "--out", str(tmp_path / "o.csv")]
        assert run(call) == 0
        errors[name] = json.loads(capsys.readouterr().out)["sideslip_rmse_deg"]
    assert errors["two_layer"] < 0.36
    assert errors["two_layer"] < 0.7 * errors["bicycle"]
    assert errors["nonlinear"] < 0.28


@pytest.mark.slow
def test_road_car_on_a_stretched_clock_is_identified_and_estimated(
    recording: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = str(recording("niki_gti") / "signals.csv.gz")
    # mass, inertia and axles as published; a guess of its tyres
    (tmp_path / "start.yaml").write_text(
        "name: start\nsource: published\nmass_kg: 1926.2\nyaw_inertia_kgm2: 2763.5\n"
        "cg_to_front_m: 1.264\ncg_to_rear_m: 1.367\n"
        "front_stiffness_nprad: 50000\nrear_stiffness_nprad: 70000\n"
    )
    start, car = str(tmp_path / "start.yaml"), str(tmp_path / "gti.yaml")
    call = ["estimate", source, "--identify", "300:400", "--vehicle", start, "--out", car]
    assert run(call) == 0
    said = capsys.readouterr()
    assert "5 times as fast" in said.err
    found = json.loads(said.out)
    assert (
        found["elsewhere"]["sideslip_rmse_deg"]
        < found["elsewhere"]["of_the_start"]["sideslip_rmse_deg"]
    )
    call = ["estimate", source, "--estimator", "nonlinear", "--vehicle", car, "--derive-gps"]
    call += ["--set", "gyro_sd_radps=0.005", "--set", "course_sd_rad=0.005", "--span", "60:300"]
    assert run([*call, "--out", str(tmp_path / "o.csv")]) == 0
    assert json.loads(capsys.readouterr().out)["sideslip_rmse_deg"] < 0.35


def test_several_spans_and_a_further_log_are_fitted_together(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    car = load_car("passat")
    (tmp_path / "car.yaml").write_text(dump_car(car))
    for name, seed in (("a", 0), ("b", 1)):
        made = driven(car, 24.0, seed=seed)
        table = pd.DataFrame({"stamp_s": made.stamp_s, **made.columns})
        table.to_csv(tmp_path / f"{name}.csv", index=False)
    call = ["estimate", str(tmp_path / "a.csv"), "--vehicle", str(tmp_path / "car.yaml")]
    call += ["--identify", "0:6,8:14", "--also", str(tmp_path / "b.csv")]
    assert run([*call, "--out", str(tmp_path / "mine.yaml")]) == 0
    said = capsys.readouterr()
    line = json.loads(said.out)
    assert line["rows"] == 600 + 600 + 2400
    assert line["elsewhere"]["sideslip_rmse_deg"] < 0.3
    assert "front_friction" in said.err
    alone = ["estimate", str(tmp_path / "a.csv"), "--vehicle", "passat", "--estimator", "bicycle"]
    assert run([*alone, "--also", "b.csv", "--out", str(tmp_path / "o.csv")]) == 2
    assert "--also goes with --identify" in capsys.readouterr().err


def test_a_faulty_sensor_is_told_in_json_on_the_terminal_and_on_the_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clean = fault_drives.driven(load_car("passat"), "country", 22.0, seed=12).log
    log = fault_drives.faulty(clean, "steering", "step", 12.0, 17.0, np.random.default_rng(0))
    path, out = tmp_path / "log.csv", tmp_path / "out.csv"
    pd.DataFrame({"stamp_s": log.stamp_s, **log.columns}).to_csv(path, index=False)
    words = ["estimate", str(path), "--estimator", "bicycle", "--vehicle", "passat"]
    words += ["--out", str(out), "--force"]
    assert run(words) == 0
    shown = capsys.readouterr()
    (fault,) = json.loads(shown.out.strip().splitlines()[-1])["faults"]
    assert fault["sensor"] == "steering"
    assert 12.0 <= fault["found_s"] <= 14.0
    assert 17.0 < fault["to_s"] < 22.0
    assert "fault: steering: leaps by" in shown.err
    assert "within a row" in out.with_suffix(".html").read_text(encoding="utf-8")
    assert run([*words, "--no-page", "--set", "isolate_faults=false"]) == 0
    assert "faults" not in json.loads(capsys.readouterr().out.strip().splitlines()[-1])


def test_fixes_of_an_nmea_log_join_a_signal_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The receiver counts UTC, the log from 0; its rows carry course and speed then."""
    log = fault_drives.driven(load_car("passat"), "country", 40.0, seed=3).log
    names = ("road_wheel_angle_rad", "yaw_rate_radps", "ax_mps2", "ay_mps2", "vx_mps")
    path, out = tmp_path / "log.csv", tmp_path / "out.csv"
    columns = {name: log.columns[name] for name in names}
    pd.DataFrame({"stamp_s": log.stamp_s, **columns}).to_csv(path, index=False)
    rows = np.flatnonzero(np.isfinite(log.columns["course_rad"]))
    lines = []
    for row in rows.tolist():
        knots = log.columns["speed_mps"][row] / 0.514444
        course = (90.0 - np.degrees(log.columns["course_rad"][row])) % 360.0
        body = (
            f"GPRMC,1200{log.stamp_s[row]:05.2f},A,4900.0000,N,00800.0000,E,"
            f"{knots:.3f},{course:.3f},010626,,"
        )
        lines.append(f"${body}*{reduce(xor, body.encode()):02X}")
    (tmp_path / "gps.nmea").write_text("\n".join(lines) + "\n")
    words = ["estimate", str(path), "--estimator", "two_layer", "--vehicle", "passat"]
    words += ["--out", str(out), "--no-page", "--set", "heading_walk_rad=0.01"]
    assert run(words) == 2  # no GPS in the log
    assert run([*words, "--gps", str(tmp_path / "gps.nmea")]) == 0
    shown = capsys.readouterr()
    assert f"{len(rows)} fixes join the log" in shown.err
    slip = pd.read_csv(out)["sideslip_rad"].to_numpy()
    assert np.degrees(np.abs(slip - log.columns["sideslip_rad"])[500:]).max() < 1.0
    (tmp_path / "none.nmea").write_text("$GPGGA\n")
    assert run([*words, "--gps", str(tmp_path / "none.nmea")]) == 2
