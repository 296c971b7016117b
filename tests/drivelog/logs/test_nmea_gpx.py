"""NMEA and GPX logs as fixes: dates, midnight, talkers, damage, and what they cannot say."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from functools import reduce
from pathlib import Path

import numpy as np
import pytest

from polemap.drivelog.errors import InputError
from polemap.drivelog.logs.gpx import read_gpx
from polemap.drivelog.logs.nmea import read_nmea
from polemap.drivelog.readers.registry import open_drive
from polemap.tools import cli
from tests.drivelog.logs.recorded import Journey, cells, journey, table, write_mapping


def sentence(body: str) -> str:
    return f"${body}*{reduce(lambda a, b: a ^ b, body.encode()):02X}"


def _angle(value: float, digits: int, sides: str) -> str:
    whole, minutes = divmod(abs(value) * 60.0, 60.0)
    return f"{int(whole):0{digits}d}{minutes:011.8f},{sides[int(value < 0)]}"


def epoch(
    stamp: float, latitude: float, longitude: float, *, talker: str = "GN", course: float = 90.0,
    quality: int = 1, kinds: Sequence[str] = ("RMC", "GSA", "GGA", "VTG"),
) -> list[str]:  # fmt: skip
    """The sentences of one moment."""
    t = datetime.fromtimestamp(stamp, UTC)
    clock = t.strftime("%H%M%S.") + f"{round(t.microsecond / 1e4) % 100:02d}"
    place = f"{_angle(latitude, 2, 'NS')},{_angle(longitude, 3, 'EW')}"
    valid = "A" if quality else "V"
    body = {
        "RMC": f"{talker}RMC,{clock},{valid},{place},19.438,{course:.2f},{t:%d%m%y},,,A",
        "GGA": f"{talker}GGA,{clock},{place},{quality},09,,520.0,M,46.9,M,,",
        "GSA": f"{talker}GSA,A,3,04,05,,09,12,,,24,,,,,2.5,1.3,2.1",
        "VTG": f"{talker}VTG,{course:.2f},T,,M,19.438,N,36.0,K,A",
    }
    return [sentence(body[kind]) for kind in kinds]


def track(road: Journey, step: int = 10, **options: object) -> list[str]:
    lines: list[str] = []
    for row in range(0, len(road.stamp_s), step):
        place = road.latitude_deg[row], road.longitude_deg[row]
        lines += epoch(road.stamp_s[row], *place, **options)  # type: ignore[arg-type]
    return lines


def write(path: Path, lines: Sequence[str]) -> Path:
    path.write_bytes("\r\n".join(lines).encode("latin-1") + b"\r\n")
    return path


def test_fixes_of_a_receiver(tmp_path: Path) -> None:
    road = journey(300)
    log = read_nmea(write(tmp_path / "a.nmea", track(road)))
    np.testing.assert_allclose(log.columns["stamp_s"], road.stamp_s[::10], atol=1e-6)
    np.testing.assert_allclose(log.columns["latitude_deg"], road.latitude_deg[::10], atol=1e-9)
    np.testing.assert_allclose(log.columns["longitude_deg"], road.longitude_deg[::10], atol=1e-9)
    np.testing.assert_allclose(log.columns["hdop"][1:], 1.3)
    np.testing.assert_allclose(log.columns["speed_mps"], 10.0, atol=1e-3)
    assert log.rows_read == 120
    assert not log.dropped


@pytest.mark.parametrize(("latitude", "longitude"), [(-33.9, 151.2), (48.0, -0.05), (0.01, -179.9)])
def test_all_quarters_of_the_earth(latitude: float, longitude: float, tmp_path: Path) -> None:
    log = read_nmea(write(tmp_path / "a.nmea", epoch(1.7e9, latitude, longitude)))
    np.testing.assert_allclose(log.columns["latitude_deg"], latitude, atol=1e-9)
    np.testing.assert_allclose(log.columns["longitude_deg"], longitude, atol=1e-9)


def test_midnight_with_and_without_dates(tmp_path: Path) -> None:
    stamps = 1_714_608_000.0 - 2.5 + np.arange(6)  # 2024-05-02 00:00 UTC
    lines = [x for t in stamps for x in epoch(t, 48.0, 11.0)]
    log = read_nmea(write(tmp_path / "a.nmea", lines))
    np.testing.assert_allclose(log.columns["stamp_s"], stamps)
    only = [x for t in stamps for x in epoch(t, 48.0, 11.0, kinds=["GGA"])]
    log = read_nmea(write(tmp_path / "b.nmea", only), "2024-05-01")
    np.testing.assert_allclose(log.columns["stamp_s"], stamps)
    with pytest.raises(InputError, match=r"no date.*--date 2024-05-31"):
        read_nmea(tmp_path / "b.nmea")
    with pytest.raises(InputError, match="'yesterday' is no day"):
        read_nmea(tmp_path / "b.nmea", "yesterday")


def test_the_date_may_come_late(tmp_path: Path) -> None:
    stamps = 1_714_608_000.0 - 2.5 + np.arange(6)
    lines = [x for t in stamps[:4] for x in epoch(t, 48.0, 11.0, kinds=["GGA"])]
    lines += [x for t in stamps[4:] for x in epoch(t, 48.0, 11.0)]
    log = read_nmea(write(tmp_path / "a.nmea", lines))
    np.testing.assert_allclose(log.columns["stamp_s"], stamps)
    zda = sentence("GPZDA,235957.50,01,05,2024,00,00")
    lines = [zda, *(x for t in stamps for x in epoch(t, 48.0, 11.0, talker="GP", kinds=["GGA"]))]
    log = read_nmea(write(tmp_path / "b.nmea", lines))
    np.testing.assert_allclose(log.columns["stamp_s"], stamps)


def test_damage_is_counted(tmp_path: Path) -> None:
    road = journey(200)
    lines = track(road)
    lines[2] = lines[2].replace("4", "5", 1)  # a wrong digit, the checksum tells
    lines[6] = lines[6][:30]
    lines[10] = lines[10].rpartition("*")[0]  # no checksum, where others have one
    lines.insert(12, "boot \xff\xfe")
    lines.insert(13, sentence("GPGSV,1,1,00"))
    lines.insert(14, sentence("GNGGA,12xx00,,,,,1,,,,,,,"))
    log = read_nmea(write(tmp_path / "a.nmea", lines))
    assert log.dropped == {"damaged sentences": 4, "lines without a sentence": 1,
                           "other sentences": 1}  # fmt: skip
    assert len(log.columns["stamp_s"]) == 20  # RMC stands in for the lost GGA


def test_a_receiver_without_checksums(tmp_path: Path) -> None:
    lines = [line.rpartition("*")[0] for line in track(journey(100))]
    log = read_nmea(write(tmp_path / "a.nmea", lines))
    assert "40 sentences without a checksum were taken" in log.says
    assert len(log.columns["stamp_s"]) == 10


def test_several_talkers_and_lost_fixes(tmp_path: Path) -> None:
    road = journey(100)
    lines = []
    for row in range(0, 100, 10):
        place = road.latitude_deg[row], road.longitude_deg[row]
        lines += epoch(road.stamp_s[row], *place, talker="GP")
        lines += epoch(road.stamp_s[row], place[0] + 0.1, place[1], talker="GL", kinds=["GGA"])
        if row > 50:
            lines += epoch(road.stamp_s[row] + 0.5, *place, talker="GP", quality=0)
    log = read_nmea(write(tmp_path / "a.nmea", lines))
    np.testing.assert_allclose(log.columns["latitude_deg"], road.latitude_deg[::10], atol=1e-9)
    assert log.dropped == {"fixes of another talker": 10, "epochs without a fix": 4}


def test_a_logger_that_stamps_the_lines(tmp_path: Path) -> None:
    lines = [f"17:00:01.123 > {line}" for line in track(journey(50))]
    assert len(read_nmea(write(tmp_path / "a.txt", lines)).columns["stamp_s"]) == 5


@pytest.mark.parametrize("lines", [["$GPGSV,1,1,00*79"], ["hello"], [""]])
def test_nothing_that_can_be_used(lines: list[str], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no GGA or RMC"):
        read_nmea(write(tmp_path / "a.nmea", lines))


GPX = """<?xml version="1.0"?>
<gpx version="1.1" creator="x" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>
{}
</trkseg></trk></gpx>"""


def points(road: Journey, step: int = 10) -> list[str]:
    return [
        f'<trkpt lat="{road.latitude_deg[i]:.9f}" lon="{road.longitude_deg[i]:.9f}"><ele>5</ele>'
        f"<time>{datetime.fromtimestamp(road.stamp_s[i], UTC):%Y-%m-%dT%H:%M:%S.%fZ}</time>"
        "<hdop>1.7</hdop></trkpt>"
        for i in range(0, len(road.stamp_s), step)
    ]


def test_gpx_tracks(tmp_path: Path) -> None:
    road = journey(100)
    made = points(road)
    made[2] = made[2].replace("<time>", "<when>").replace("</time>", "</when>")
    made[3] = made[3].replace('lat="4', 'lat="94')
    made[4] = made[4].replace("lat=", "breite=")
    made[5] = made[5].replace(">1.7<", ">good<")
    (tmp_path / "a.gpx").write_text(GPX.format("\n".join(made)))
    log = read_gpx(tmp_path / "a.gpx")
    kept = [0, 10, 50, 60, 70, 80, 90]
    np.testing.assert_allclose(log.columns["stamp_s"], road.stamp_s[kept], atol=1e-5)
    np.testing.assert_allclose(log.columns["latitude_deg"], road.latitude_deg[kept], atol=1e-9)
    assert log.rows_read == 10
    assert sum(log.dropped.values()) == 4
    assert np.isnan(log.columns["hdop"][2])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            GPX.format('<trkpt lat="1" lon="2"/>'),
            "none of 1 track points can be used "
            r"\(1 points without a time\)",
        ),
        (
            GPX.format('<trkpt lat="nan" lon="2"><time>2024-01-01T00:00:00Z</time></trkpt>'),
            "1 points off the earth",
        ),
        (GPX.format(""), "no track points"),
        ("<kml/>", "its root is called otherwise"),
        (GPX.format("")[:80], "no GPX"),
        (
            '<!DOCTYPE gpx [<!ENTITY a "b">]>' + GPX.format("")[22:],
            "a.gpx: GPX .* entities is not read",
        ),
    ],
)
def test_gpx_that_cannot_be_used(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "a.gpx").write_text(text)
    with pytest.raises(InputError, match=message):
        read_gpx(tmp_path / "a.gpx")


@pytest.mark.parametrize("kind", ["nmea", "gpx"])
def test_a_drive_of_fixes_and_odometry(kind: str, tmp_path: Path) -> None:
    """Found by what stands in it, whatever it is called."""
    road = journey(300)
    log = tmp_path / "position.log"
    if kind == "nmea":
        write(log, track(road))
    else:
        log.write_text(GPX.format("\n".join(points(road))))
    rows = {"t_s": cells(road.stamp_s), "v": cells(road.speed_mps), "r": cells(road.yaw_rate_radps)}
    (tmp_path / "can.csv").write_text(table(rows))
    odometry = {
        "stamp_s": "t_s",
        "speed_mps": {"column": "v", "unit": "m/s"},
        "yaw_rate_radps": {"column": "r", "unit": "rad/s"},
    }
    mapping = write_mapping(tmp_path / "m.yaml", odometry=odometry)
    words = ["convert", str(log), str(tmp_path / "can.csv"), "--mapping", str(mapping)]
    assert cli.run([*words, "--out", str(tmp_path / "d")]) == cli.GOOD
    drive = open_drive(tmp_path / "d")
    assert drive.gnss is not None
    np.testing.assert_allclose(drive.gnss.east_m, road.east_m[::10], atol=1e-3)
    assert drive.odometry is not None


def test_fixes_directly(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without a mapping: gnss.csv, or a drive whose wheelbase is given."""
    log = str(write(tmp_path / "a.nmea", track(journey(300))))
    assert cli.run(["convert", log, "--out", str(tmp_path / "gnss.csv")]) == cli.GOOD
    text = (tmp_path / "gnss.csv").read_text().splitlines()
    assert text[0].startswith("stamp_s,latitude_deg,longitude_deg,hdop")
    assert len(text) == 31
    assert cli.run(["convert", log, "--out", str(tmp_path / "d")]) == cli.USER_ERROR
    assert "--wheelbase 2.71" in capsys.readouterr().err
    words = ["convert", log, "--out", str(tmp_path / "d"), "--wheelbase", "2.7"]
    assert cli.run(words) == cli.GOOD
    assert open_drive(tmp_path / "d").wheelbase_m == 2.7


def test_course_and_speed_as_signals(tmp_path: Path) -> None:
    log = write(tmp_path / "a.nmea", track(journey(100)))
    signals = {
        "file": "a.nmea",
        "speed_mps": "speed_mps",
        "course_rad": {"column": "course_deg", "turn": "clockwise", "from": "true_north"},
    }
    mapping = write_mapping(tmp_path / "m.yaml", signals=signals)
    words = ["convert", str(log), "--mapping", str(mapping), "--out", str(tmp_path / "s.csv")]
    assert cli.run(words) == cli.GOOD
    rows = (tmp_path / "s.csv").read_text().splitlines()
    assert rows[0] == "stamp_s,speed_mps,course_rad"
    assert rows[1].endswith(",0")
