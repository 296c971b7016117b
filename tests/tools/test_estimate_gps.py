"""`polemap estimate --gps` on logs that receivers should not write and do."""

from __future__ import annotations

import re
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from polemap.tools.cli import run

T = np.arange(0.0, 40.0, 0.02)
SPEED = 12.0 + 3.0 * np.sin(0.4 * T) + 0.5 * np.sin(1.3 * T)
RATE = 0.05 * np.sin(0.3 * T)
HEADING = np.cumsum(RATE) * 0.02
FIXES = range(0, len(T), 10)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    columns = {"stamp_s": T, "vx_mps": SPEED, "yaw_rate_radps": RATE, "ay_mps2": SPEED * RATE}
    columns["road_wheel_angle_rad"] = 2.7 * RATE / SPEED
    pd.DataFrame(columns).to_csv(tmp_path / "log.csv", index=False)
    return tmp_path / "log.csv"


def sentence(body: str) -> str:
    return f"${body}*{reduce(xor, body.encode()):02X}"


def place(degrees: float, digits: int) -> str:
    return f"{int(degrees):0{digits}d}{60.0 * (degrees % 1.0):08.5f}"


def receiver(start_s: float = 36000.0, *, rmc: bool = True) -> list[str]:
    """GGA and RMC of the drive five times a second, from a time of day on."""
    east, north = (np.cumsum(SPEED * f(HEADING)) * 0.02 / 6_371_000.0 for f in (np.cos, np.sin))
    lines = []
    for k in FIXES:
        second = start_s + T[k]
        day, clock = divmod(second, 86400.0)
        at = f"{int(clock // 3600):02d}{int(clock % 3600 // 60):02d}{clock % 60.0:05.2f}"
        latitude = 49.0 + np.degrees(north[k])
        longitude = 8.0 + np.degrees(east[k] / np.cos(np.radians(49.0)))
        where = f"{place(latitude, 2)},N,{place(longitude, 3)},E"
        lines.append(sentence(f"GPGGA,{at},{where},1,07,0.9,100.0,M,0,M,,"))
        if rmc:
            course = (90.0 - np.degrees(HEADING[k])) % 360.0
            moves = f"{SPEED[k] / 0.514444:.3f},{course:.2f},{30 if day < 1 else 31}0526"
            lines.append(sentence(f"GPRMC,{at},A,{where},{moves},,"))
    return lines


def estimate(log: Path, written: list[str] | bytes) -> int:
    path = log.parent / "gps.nmea"
    text = written if isinstance(written, bytes) else ("\r\n".join(written) + "\r\n").encode()
    path.write_bytes(text)
    call = ["estimate", str(log), "--gps", str(path), "--estimator", "stiffness", "--no-page"]
    return run([*call, "--vehicle", "passat", "--out", str(log.parent / "out.csv"), "--force"])


@pytest.mark.parametrize(
    ("written", "what"),
    [
        (receiver(), "199 fixes join the log, .* 0 courses from positions"),
        (receiver(rmc=False), "199 fixes .* 199 courses from positions"),
        (receiver(86380.0), "199 fixes join the log"),
        (receiver() * 2, "199 fixes join the log"),
        (receiver()[::-1], "199 fixes join the log"),
        (
            [*receiver(), "$GPGGA,1200", "@@"],
            "1 damaged sentences, 1 lines without a sentence",
        ),
    ],
    ids=["whole", "gga alone", "midnight", "twice", "backwards", "cut"],
)
def test_a_log_that_can_be_used_is(
    log: Path, capsys: pytest.CaptureFixture[str], written: list[str], what: str
) -> None:
    assert estimate(log, written) == 0
    said = capsys.readouterr().err
    assert re.search(what, said), said


@pytest.mark.parametrize(
    ("written", "what"),
    [
        (b"", "empty file"),
        (b"\n\n", "no GGA or RMC sentence that can be used"),
        ([line[:-1] + ("0" if line[-1] != "0" else "1") for line in receiver()], "no GGA or RMC"),
        (receiver()[:4], "2 fixes with HDOP up to 5, 3 are needed"),
        (receiver()[:150], "fits the wheels nowhere"),
        (bytes(range(256)) * 40, "NUL bytes"),
        (b"a,b\n1,2\n", "no GGA or RMC sentence that can be used"),
    ],
    ids=["empty", "blank", "checksums", "two fixes", "too short", "binary", "csv"],
)
def test_one_that_cannot_is_one_line(
    log: Path, capsys: pytest.CaptureFixture[str], written: list[str] | bytes, what: str
) -> None:
    assert estimate(log, written) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1
    assert what in said[0]
    assert "gps.nmea" in said[0]


def test_another_drives_log_is_refused(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = pd.read_csv(log)
    table["vx_mps"] = 8.0 + 2.0 * np.sin(0.9 * T)
    table.to_csv(log, index=False)
    assert estimate(log, receiver()) == 2
    assert "fits the wheels nowhere" in capsys.readouterr().err
