"""Signals, kills and closed pipes: one line, the shell's exit code, and no process left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.frames import EarthFrame
from polemap.drivelog.writers.folder import write_drive
from polemap.map.io import write_map
from polemap.tools import cli
from tests.localize.point_drives import street_drive
from tests.pole_maps import plain_map
from tests.process_groups import members

POLEMAP = [sys.executable, "-m", "polemap"]


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = street_drive(2, duration_s=8.0)
    folder = tmp_path_factory.mktemp("street")
    write_drive(made.drive, folder / "drive")
    write_map(made.pole_map, folder / "map.gpkg")
    return folder


def _signals_as_they_are() -> None:
    """Undo what a suite in the background (nohup, a shell's &) ignores for its children."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def start(street: Path, out: Path, *, runs: int) -> subprocess.Popen[str]:
    """`localize` over many seeds on two processes, in a process group of its own."""
    words = ["localize", street / "drive", "--map", street / "map.gpkg", "--out", out]
    words += ["--runs", runs, "--workers", 2, "--set", "localize.particles=150"]
    return subprocess.Popen(
        [*POLEMAP, *map(str, words)],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
        preexec_fn=_signals_as_they_are,
    )


def wait_until_at_work(out: Path, group: int) -> None:
    deadline = time.monotonic() + 60.0
    while not list(out.parent.glob(f".{out.name}.part/*/ready/.*.part")):
        assert time.monotonic() < deadline, members(group)
        time.sleep(0.02)


def wait_until_gone(group: int) -> None:
    deadline = time.monotonic() + 30.0
    while members(group):
        assert time.monotonic() < deadline, members(group)
        time.sleep(0.05)


needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc here")


@needs_proc
@pytest.mark.parametrize(
    ("name", "to_all", "code"),
    [("SIGINT", True, 130), ("SIGINT", False, 130), ("SIGTERM", False, 143), ("SIGHUP", True, 129)],
)
def test_a_signal_ends_a_command_in_one_line(
    name: str, to_all: bool, code: int, street: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    with start(street, out, runs=500) as process:
        wait_until_at_work(out, process.pid)
        number = getattr(signal, name)
        if to_all:
            os.killpg(process.pid, number)
        else:
            os.kill(process.pid, number)
        _, error = process.communicate(timeout=300)
    assert process.returncode == code
    assert error == "polemap: interrupted; nothing half-written stays under a final name\n"
    wait_until_gone(process.pid)
    assert list(tmp_path.iterdir()) == []


@needs_proc
def test_workers_end_with_a_killed_parent_and_the_next_run_tidies_up(
    street: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    with start(street, out, runs=500) as process:
        wait_until_at_work(out, process.pid)
        assert len(members(process.pid)) > 2
        process.kill()
        process.wait()
        wait_until_gone(process.pid)
    assert [path.name for path in tmp_path.iterdir()] == [".run.part"]
    with start(street, out, runs=2) as process:
        process.communicate(timeout=120)
    assert process.returncode == cli.GOOD
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def run(words: list[object], **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(  # type: ignore[call-overload, no-any-return]
        [*POLEMAP, *map(str, words)], stderr=subprocess.PIPE, text=True, timeout=300, **options
    )


def test_a_reader_that_went_away_is_told_in_one_line(street: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = run(["info", street / "map.gpkg"], stdout=writing)
    finally:
        os.close(writing)
    assert done.returncode == cli.USER_ERROR
    assert done.stderr == "polemap: stdout: nobody reads it any more; results in files are whole\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_stdout_is_told_in_one_line(street: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = run(["info", street / "map.gpkg"], stdout=full)
    assert done.returncode == cli.USER_ERROR
    assert done.stderr.count("\n") == 1
    assert done.stderr == "polemap: stdout: No space left on device\n"


def test_closed_standard_streams_are_no_obstacle(street: Path, tmp_path: Path) -> None:
    words = [*POLEMAP, "map", "--convert", street / "map.gpkg", "--out", tmp_path / "a.geojson"]
    command = " ".join(map(str, words))
    for closed in ("<&-", ">&-", "2>&-", "<&- >&- 2>&-"):
        done = subprocess.run(["sh", "-c", f"{command} {closed}"], capture_output=True, timeout=300)
        assert done.returncode == cli.GOOD, closed
    assert [path.name for path in tmp_path.iterdir()] == ["a.geojson"]


@pytest.mark.parametrize("ending", ["gpkg", "geojson", "parquet", "osm", "pbf", "xodr"])
def test_a_disk_that_is_full_costs_one_line(ending: str, tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    points = np.random.default_rng(0).uniform(0.0, 5000.0, (3000, 2)) + np.array([5e5, 5e6])
    poles = replace(plain_map(points), frame=EarthFrame("utm", epsg=32633))
    write_map(poles, tmp_path / "map.gpkg")
    out = tmp_path / f"out.{ending}"
    write_map(poles.rows(slice(3)), tmp_path / "few.gpkg")
    # an earlier result of our own: what polemap did not write it does not replace
    assert run(["map", "--convert", tmp_path / "few.gpkg", "--out", out]).returncode == cli.GOOD
    (tmp_path / "few.gpkg").unlink()
    old = out.read_bytes()
    words = ["map", "--convert", tmp_path / "map.gpkg", "--out", out]
    done = run(
        words,
        stdout=subprocess.DEVNULL,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192)),
    )
    assert done.returncode == cli.USER_ERROR
    assert done.stderr.startswith(f"polemap: {out}: cannot be written (")
    assert done.stderr.count("\n") == 1
    assert out.read_bytes() == old
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map.gpkg", out.name]


SWALLOWING = """
import sys, time
from polemap.tools import cli, interrupts

def command() -> None:
    try:
        print("at work", flush=True)
        time.sleep(60)
    except:  # noqa: E722, as some libraries do while they are imported
        pass
    print("swallowed", flush=True)
    time.sleep(60)

cli.VERBS["swallow"] = ("swallow", "x")
cli.import_module = lambda _: type("Verb", (), {"command": staticmethod(command)})
sys.argv = ["polemap", "swallow"]
cli.main()
"""


LEAKING = """
import multiprocessing, os
from polemap.tools import interrupts
interrupts.install()
lock = multiprocessing.get_context("spawn").Semaphore(1)
os._exit(0)
"""


@pytest.mark.parametrize("given", [None, "error::SyntaxWarning"])
def test_what_an_ended_pool_leaves_is_not_told_after_the_one_line(given: str | None) -> None:
    environment = dict(os.environ)
    environment.pop("PYTHONWARNINGS", None)
    if given is not None:
        environment["PYTHONWARNINGS"] = given
    # the tracker of shared resources outlives the command and holds its stderr until it has told
    done = subprocess.run(
        [sys.executable, "-c", LEAKING], capture_output=True, text=True, env=environment
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_an_interrupt_that_a_library_swallows_comes_again() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", SWALLOWING],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=_signals_as_they_are,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "at work\n"
        process.send_signal(signal.SIGINT)
        said, error = process.communicate(timeout=30)
    assert said == "swallowed\n"
    assert process.returncode == 130
    assert error == "polemap: interrupted; nothing half-written stays under a final name\n"


@needs_proc
def test_a_simulation_ends_in_one_line(tmp_path: Path) -> None:
    words = ["simulate", "park_loop", "--out", str(tmp_path / "out"), "--laps", "9"]
    with subprocess.Popen(
        [*POLEMAP, *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=_signals_as_they_are,
    ) as process:
        deadline = time.monotonic() + 60.0
        while not list(tmp_path.glob(".*.part")) and process.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGINT)
        _, error = process.communicate(timeout=30)
    assert process.returncode == 130, error
    assert error == "polemap: interrupted; nothing half-written stays under a final name\n"
    assert list(tmp_path.iterdir()) == []
    wait_until_gone(process.pid)


def test_a_signal_in_a_finaliser_prints_no_traceback() -> None:
    """What is raised there is printed by Python and dropped; the command is told once more."""
    script = (
        "import os, signal, time\n"
        "from polemap.tools import interrupts\n"
        "interrupts.install()\n"
        "class Last:\n"
        "    def __del__(self):\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "        time.sleep(1.0)\n"
        "try:\n"
        "    Last()\n"
        "    time.sleep(30.0)\n"
        "except interrupts.Stopped:\n"
        "    interrupts.finished()\n"
        "    raise SystemExit(interrupts.exit_code())\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, timeout=60)
    assert (done.returncode, done.stderr) == (128 + signal.SIGTERM, b"")


@pytest.mark.parametrize("layout", ["kitti_odometry", "kitti_raw"])
def test_a_place_that_cannot_be_written_is_told_before_the_work(
    layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(*_args: object, **_more: object) -> None:
        raise OSError(30, "Read-only file system")

    def never(*_args: object, **_more: object) -> None:
        raise AssertionError("work began")

    monkeypatch.setattr("polemap.simulate.drive.simulate_drive", never)
    monkeypatch.setattr("polemap.simulate.drive.count_frames", lambda *_: 0)
    monkeypatch.setattr(Path, "mkdir", refused)
    words = ["simulate", "park_loop", "--out", str(tmp_path / "k"), "--format", layout]
    assert cli.run(words) == cli.USER_ERROR
    assert "k: cannot be written (Read-only file system)" in capsys.readouterr().err
