"""`polemap localize --follow`: streams that grow, end, rest, are interrupted or damaged."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polemap.drivelog.live.growing import GrowingBytes
from polemap.drivelog.readers.registry import open_drive
from polemap.drivelog.samples import Detections, GnssFix, OdometrySample, ReferencePose
from polemap.drivelog.writers.folder import write_drive
from polemap.drivelog.writers.ros.drive import write_drive_mcap
from polemap.map.io import write_map
from polemap.settings import Settings
from polemap.tools import cli
from polemap.tools.follow.engine import Engine, Tick
from polemap.tools.follow.source import open_followed
from tests.localize.point_drives import street_drive

FEW = ["--set", "localize.particles=150"]
ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = street_drive(2, duration_s=6.0)
    folder = tmp_path_factory.mktemp("street")
    write_drive(made.drive, folder / "drive")
    write_map(made.pole_map, folder / "map.gpkg")
    write_drive_mcap(made.drive, folder / "d.mcap")
    (folder / "lines.jsonl").write_text("".join(json_lines(folder / "drive")))
    return folder


def json_lines(folder: Path) -> list[str]:
    lines = []
    for sample in open_drive(folder).samples():
        if isinstance(sample, ReferencePose):
            continue
        line: dict[str, Any] = {"stamp_s": sample.stamp_s, "arrival_s": sample.arrival_s}
        if isinstance(sample, OdometrySample):
            line |= {"type": "odometry", "speed_mps": sample.speed_mps,
                     "yaw_rate_radps": sample.yaw_rate_radps}  # fmt: skip
        elif isinstance(sample, GnssFix):
            line |= {"type": "gnss", "east_m": sample.east_m, "north_m": sample.north_m,
                     "hdop": sample.hdop}  # fmt: skip
        else:
            assert isinstance(sample, Detections)
            poles = zip(sample.points_vehicle_m, sample.covariance_m2, strict=True)
            line |= {"type": "poles", "poles": [
                {"x_m": p[0], "y_m": p[1], "var_x_m2": c[0, 0], "var_y_m2": c[1, 1],
                 "cov_xy_m2": c[0, 1]} for p, c in poles]}  # fmt: skip
        lines.append(json.dumps(line) + "\n")
    return lines


def follow(*words: object) -> int:
    return cli.run(["localize", "--follow", *map(str, words)])


def command(*words: object) -> list[str]:
    return [sys.executable, "-m", "polemap", "localize", "--follow", *map(str, words)]


ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}


def test_a_growing_recording_gives_the_pose_at_every_tick(
    street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = (street / "d.mcap").read_bytes()
    growing = tmp_path / "growing.mcap"
    growing.write_bytes(whole[:100])

    def write() -> None:
        with growing.open("ab", buffering=0) as file:
            for start in range(100, len(whole), len(whole) // 20):
                time.sleep(0.02)
                file.write(whole[start : start + len(whole) // 20])

    writer = threading.Thread(target=write)
    writer.start()
    words = [growing, "--map", street / "map.gpkg", "--out", tmp_path / "run", *FEW]
    assert follow(*words) == cli.GOOD
    writer.join()
    said = capsys.readouterr()
    rows = [json.loads(line) for line in said.out.splitlines()]
    stamps = np.array([row["stamp_s"] for row in rows])
    assert np.diff(stamps).min() >= 0.01 - 1e-9
    assert {"healthy", "distrust", "lag_s", "frames_skipped", "position_sd_m"} <= set(rows[0])
    reference = open_drive(street / "drive").reference
    assert reference is not None
    truth = reference.at(stamps)
    places = np.array([(row["east_m"], row["north_m"]) for row in rows])
    wrong = np.hypot(*(places - truth[:, :2]).T)
    # it starts by GNSS alone, and comes as fast as the file is written
    assert np.nanmin(wrong) < 1.0
    assert "verdict: " in said.err
    assert "listening to /gnss/position, /poles" in said.err
    assert "next: polemap view" in said.err
    words = ["convert", tmp_path / "run", "--out", tmp_path / "t.tum"]
    assert cli.run(list(map(str, words))) == cli.GOOD
    assert len((tmp_path / "t.tum").read_text().splitlines()) == len(rows)


def test_lines_on_standard_input_in_real_time(street: Path) -> None:
    lines = (street / "lines.jsonl").read_text().splitlines(keepends=True)
    words = command("-", "--car", street / "drive", "--map", street / "map.gpkg", *FEW)
    with subprocess.Popen(
        words, env=ENVIRONMENT, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        first = json.loads(lines[0])["arrival_s"]
        found: list[str] = []
        reader = threading.Thread(target=lambda: found.extend(process.stdout or ()))
        reader.start()
        process.stdin.write('{"not": "a sample"}\n')
        begin = time.monotonic()
        for line in lines:
            ahead = json.loads(line)["arrival_s"] - first - (time.monotonic() - begin)
            if ahead > 0:
                time.sleep(ahead)
            process.stdin.write(line)
            process.stdin.flush()
        process.stdin.close()
        reader.join()
        said = process.stderr.read()
        assert process.wait() == cli.GOOD
    rows = [json.loads(line) for line in found]
    reference = open_drive(street / "drive").reference
    assert reference is not None
    truth = reference.at([row["stamp_s"] for row in rows])
    places = np.array([(row["east_m"], row["north_m"]) for row in rows])
    # how soon poles take over from the fixes depends on how busy the machine is
    assert np.nanmedian(np.hypot(*(places - truth[:, :2]).T)) < 3.0
    assert "line 1: stamp_s is missing" in said
    assert "1 lines unusable" in said
    assert "verdict: " in said


def test_ctrl_c_ends_with_the_summary(street: Path, tmp_path: Path) -> None:
    words = command(street / "d.mcap", "--map", street / "map.gpkg", *FEW)
    # the file ends with its index; one that rests is waited for
    resting = tmp_path / "resting.mcap"
    resting.write_bytes((street / "d.mcap").read_bytes()[:-4000])
    words[words.index(str(street / "d.mcap"))] = str(resting)
    process = subprocess.Popen(
        words, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == cli.GOOD
    assert "verdict: " in said
    assert "Traceback" not in said


def test_a_reader_that_goes_away_costs_no_run(street: Path, tmp_path: Path) -> None:
    resting = tmp_path / "resting.mcap"
    resting.write_bytes((street / "d.mcap").read_bytes()[:-4000])
    words = command(resting, "--without-poles", "--out", tmp_path / "run", "--idle", "20", *FEW)
    process = subprocess.Popen(
        words, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    said = process.stderr.read()
    assert process.wait(timeout=60) == cli.GOOD
    assert "stdout cannot be written any more" in said
    assert (tmp_path / "run" / "kf.tum").stat().st_size > 0


def test_a_reader_of_both_streams_that_goes_away_costs_no_run(street: Path, tmp_path: Path) -> None:
    """As `2>&1 | head` does; pictures may be looked at while nothing can be said any more."""
    resting = tmp_path / "resting.mcap"
    resting.write_bytes((street / "d.mcap").read_bytes()[:-4000])
    words = command(resting, "--map", street / "map.gpkg", "--out", tmp_path / "run", *FEW)
    process = subprocess.Popen(
        words, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert process.stdout is not None
    while (line := process.stdout.readline()) and not line.startswith("{"):
        pass
    process.stdout.close()
    assert process.wait(timeout=60) == cli.GOOD
    assert (tmp_path / "run" / "kf.tum").stat().st_size > 0


def test_bursts_are_in_time_where_a_delay_is_asked_for(
    street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As the chunks of a recorder come, 0.7 s of samples at once."""
    lines = (street / "lines.jsonl").read_text().splitlines(keepends=True)
    arrivals = [json.loads(line)["arrival_s"] for line in lines]
    growing = tmp_path / "lines.jsonl"
    growing.write_text(lines[0])

    def write() -> None:
        begin = time.monotonic()
        with growing.open("a") as file:
            for until in np.arange(0.7, arrivals[-1] - arrivals[0] + 0.7, 0.7):
                time.sleep(max(0.0, begin + until - time.monotonic()))
                file.writelines(
                    line
                    for line, arrival in zip(lines[1:], arrivals[1:], strict=True)
                    if until - 0.7 <= arrival - arrivals[0] < until
                )
                file.flush()

    writer = threading.Thread(target=write)
    writer.start()
    words = [growing, "--car", street / "drive", "--map", street / "map.gpkg", *FEW]
    assert follow(*words, "--delay", "1.0", "--idle", "2") == cli.GOOD
    writer.join()
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert len(rows) > 100
    assert min(row["lag_s"] for row in rows) >= 1.0 - 1e-3
    inside = [row for row in rows if row["stamp_s"] <= arrivals[-1]]
    silent = sum(row["distrust"] == "odometry_silent" for row in inside)
    assert silent < 0.1 * len(inside)


def test_an_output_that_fails_ends_the_threads_first(street: Path) -> None:
    source = GrowingBytes(str(street / "d.mcap"), threading.Event())
    engine = Engine(open_followed(source, None, None), None, Settings(), 0)

    def send(_tick: Any) -> None:
        raise RuntimeError("no more")

    with pytest.raises(RuntimeError, match="no more"):
        engine.run(threading.Event(), send, lambda: None)
    assert "pictures" not in {thread.name for thread in threading.enumerate()}


def test_a_resting_file_ends_where_that_is_asked_for(
    street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    resting = tmp_path / "resting.mcap"
    resting.write_bytes((street / "d.mcap").read_bytes()[:-4000])
    words = [resting, "--without-poles", "--idle", "0.2", *FEW]
    assert follow(*words) == cli.GOOD
    said = capsys.readouterr()
    assert "verdict: " in said.err
    assert said.out.count("\n") > 10


def test_a_stream_that_is_read_before_it_is_asked_is_answered_all_the_same(
    street: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On a busy machine the reader may be at the end before the first tick."""
    ticks = Engine._ticks

    def late(engine: Engine, number: int | None, send: Callable[[Tick], None]) -> int | None:
        while number is None and not engine._all_read:
            time.sleep(0.01)
        return ticks(engine, number, send)

    monkeypatch.setattr(Engine, "_ticks", late)
    resting = tmp_path / "resting.mcap"
    resting.write_bytes((street / "d.mcap").read_bytes()[:-4000])
    assert follow(resting, "--without-poles", "--idle", "0.2", *FEW) == cli.GOOD
    said = capsys.readouterr()
    assert "verdict: " in said.err
    assert said.out.count("\n") > 10


def test_a_stream_without_a_position_says_so(
    tmp_path: Path, street: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "few").write_text('{"type": "odometry", "stamp_s": 1}\n')
    words = [tmp_path / "few", "--car", street / "drive", "--without-poles", "--idle", "0.1"]
    assert follow(*words) == cli.GOOD
    said = capsys.readouterr()
    assert said.out == ""
    assert "no position was known at any time" in said.err
    assert "1 lines unusable" in said.err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["gone.mcap", "--map", "MAP"], "no such file to follow"),
        (["MCAP"], "localize needs a map"),
        (["LINES", "--map", "MAP"], "needs --car DRIVE"),
        (["LINES", "--map", "MAP", "--car", "DRIVE", "--topics", "t.yaml"], "is for recordings"),
        (["MAP", "--map", "MAP", "--idle", "0.1"], "neither an MCAP recording nor lines of JSON"),
        (["EMPTY", "--map", "MAP", "--idle", "0.1"], "ended before its first byte"),
        (["BARE", "--map", "MAP", "--idle", "0.1"], "does not describe its car"),
        (["MCAP", "--map", "MAP", "--lap", "x"], "--follow and --lap exclude each other"),
        (["MCAP", "--map", "MAP", "--runs", "3"], "--follow and --runs exclude each other"),
        (["MCAP", "--map", "MAP", "--serve", "port"], "expected [HOST:]PORT"),
        (["MCAP", "--map", "MAP", "--serve", "70000"], "expected [HOST:]PORT"),
        (["MCAP", "--map", "MAP", "--out", "DRIVE"], "holds a drive"),
        (["MCAP", "--map", "MAP", "--car", "BARE", "--topics", "MAP"], "map.gpkg"),
    ],
)
def test_what_cannot_be_followed_is_one_line(
    words: list[str], message: str, street: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    (tmp_path / "empty").touch()
    (tmp_path / "bare.mcap").write_bytes(b"\x89MCAP0\r\n")
    places = {"MCAP": street / "d.mcap", "MAP": street / "map.gpkg", "DRIVE": street / "drive",
              "LINES": street / "lines.jsonl", "EMPTY": tmp_path / "empty",
              "BARE": tmp_path / "bare.mcap"}  # fmt: skip
    assert follow(*(places.get(word, word) for word in words)) == cli.USER_ERROR
    error = capsys.readouterr().err
    assert message in error
    assert error.count("polemap: ") == 1


def test_options_of_following_go_with_it(
    street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["localize", street / "drive", "--map", street / "map.gpkg", "--out", tmp_path / "r"]
    assert cli.run([*map(str, words), "--serve", "8765"]) == cli.USER_ERROR
    assert "--serve goes with --follow" in capsys.readouterr().err
    assert cli.run([*map(str, words), "--delay", "1"]) == cli.USER_ERROR
    assert "--delay goes with --follow" in capsys.readouterr().err
    assert cli.run(["localize", "--map", str(street / "map.gpkg")]) == cli.USER_ERROR
    assert "DRIVE and --out are needed" in capsys.readouterr().err
