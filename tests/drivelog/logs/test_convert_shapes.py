"""The same journey in the dialects of many loggers becomes the same drive."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.drivelog.logs.recorded import (
    Journey,
    cells,
    clock,
    columns,
    convert,
    journey,
    table,
)

KMH = 3.6
Dialect = Callable[[Journey], tuple[str | bytes, dict[str, Any]]]


def _plain(road: Journey, decimal: str = ".") -> dict[str, list[str]]:
    return {
        "v": cells(road.speed_mps * KMH, decimal=decimal),
        "gz": cells(np.degrees(road.yaw_rate_radps), decimal=decimal),
    }


def iso_zulu(road: Journey) -> tuple[str, dict[str, Any]]:
    times = clock(road.stamp_s, lambda t: t.isoformat().replace("+00:00", "Z"))
    return table({"time": times, **_plain(road)}), {
        "odometry": {"stamp_s": {"column": "time"}, **columns()}
    }


def iso_in_berlin(road: Journey) -> tuple[str, dict[str, Any]]:
    times = clock(road.stamp_s + 7200.0, lambda t: t.replace(tzinfo=None).isoformat(" "))
    return table({"time": times, **_plain(road)}), {
        "odometry": {"stamp_s": {"column": "time", "zone": "Europe/Berlin"}, **columns()}
    }


def german_excel(road: Journey) -> tuple[str, dict[str, Any]]:
    """Semicolons, decimal commas, a preamble, units below the names, an empty cell at the end."""
    times = clock(road.stamp_s, lambda t: t.strftime("%d.%m.%Y"))
    of_day = clock(road.stamp_s, lambda t: t.strftime("%H:%M:%S.%f"))
    body = table({"Datum": times, "Zeit": of_day, **_plain(road, ",")}, ";", header=False)
    head = "Messung 7;;;;\nFahrer;A. B.;;;\nDatum;Zeit;v;gz;\n;;[km/h];[°/s];\n"
    text = head + "".join(f"{line};\n" for line in body.splitlines())
    stamps = {"columns": ["Datum", "Zeit"], "format": "%d.%m.%Y %H:%M:%S.%f", "zone": "UTC"}
    return text, {"odometry": {"stamp_s": stamps, "speed_mps": "v", "yaw_rate_radps": "gz"}}


def utf16_tabs(road: Journey) -> tuple[bytes, dict[str, Any]]:
    text = table({"t [ms]": cells(road.stamp_s * 1e3, "%.0f"), **_plain(road)}, "\t")
    return text.encode("utf-16"), {"odometry": {"stamp_s": {"column": "t [ms]"}, **columns()}}


def byte_order_mark_and_comments(road: Journey) -> tuple[bytes, dict[str, Any]]:
    lines = table({"t_us": cells(road.stamp_s * 1e6, "%.0f"), **_plain(road)}).splitlines()
    lines.insert(5, "# the driver sneezed, twice")
    text = "\n".join(["# logger 4", *lines]) + "\n"
    return text.encode("utf-8-sig"), {"odometry": {"stamp_s": {"column": "t_us"}, **columns()}}


def no_header(road: Journey) -> tuple[str, dict[str, Any]]:
    text = table({"t": cells(road.stamp_s * 1e9, "%.0f"), **_plain(road)}, header=False)
    return text, {
        "odometry": {"stamp_s": {"column": 1, "unit": "ns"}, **columns(2, 3)}  # type: ignore[arg-type]
    }


def savetxt(road: Journey) -> tuple[str, dict[str, Any]]:
    """Blanks between the columns, names in a comment."""
    text = table({"t": cells(road.stamp_s), **_plain(road)}, "   ", header=False)
    return "# t v gz\n" + text, {"odometry": {"stamp_s": {"column": "t", "unit": "s"}, **columns()}}


def quoted(road: Journey) -> tuple[str, dict[str, Any]]:
    """Every cell in quotes, decimal commas inside, an unused text column with commas."""
    rows = {"t_s": cells(road.stamp_s, decimal=","), **_plain(road, ",")}
    rows["remark"] = ["dry, warm"] * len(road.stamp_s)
    rows = {f'"{name}"': [f'"{cell}"' for cell in column] for name, column in rows.items()}
    return table(rows), {"odometry": {"stamp_s": "t_s", **columns()}}


def gps_time(road: Journey) -> tuple[str, dict[str, Any]]:
    gps = road.stamp_s - 315_964_800.0 + 18.0
    week = np.floor(gps / 604_800.0)
    rows = {"week": cells(week, "%.0f"), "tow": cells(gps - 604_800.0 * week), **_plain(road)}
    stamps = {"column": "tow", "week": "week", "unit": "s", "leap_seconds": 18}
    return table(rows), {"odometry": {"stamp_s": stamps, **columns()}}


def clockwise_and_wheels(road: Journey) -> tuple[str, dict[str, Any]]:
    """Two rear wheels in mph, clockwise yaw rate, an unsigned speed with a gear."""
    half = 0.8 * road.yaw_rate_radps
    mph = 1.0 / 0.44704
    rows = {
        "t_s": cells(road.stamp_s),
        "rl": cells((road.speed_mps - half) * mph),
        "rr": cells((road.speed_mps + half) * mph),
        "gear": ["D"] * len(road.stamp_s),
        "gz": cells(-road.yaw_rate_radps * 1e3),
    }
    odometry = {
        "stamp_s": "t_s",
        "speed_mps": {
            "columns": ["rl", "rr"], "unit": "mph",
            "negative_where": {"column": "gear", "in": ["R"]},
        },
        "yaw_rate_radps": {"column": "gz", "unit": "mrad/s", "turn": "clockwise"},
    }  # fmt: skip
    return table(rows), {"odometry": odometry}


def long_form(road: Journey) -> tuple[str, dict[str, Any]]:
    """A row a signal, as CAN loggers write them; the gyro is half a sample off."""
    lines = ["t_s,name,value"]
    for t, v, r in zip(road.stamp_s, road.speed_mps, road.yaw_rate_radps, strict=True):
        lines += [f"{t:.4f},speed,{v:.9f}", f"{t:.4f},gyro,{r:.9f}", f"{t:.4f},other,{r:.3f}"]
    odometry = {
        "stamp_s": "t_s",
        "where": {"column": "name", "in": ["speed"]},
        "speed_mps": {"column": "value", "unit": "m/s"},
        "yaw_rate_radps": {
            "column": "value", "unit": "rad/s", "where": {"column": "name", "in": ["gyro"]},
        },
    }  # fmt: skip
    return "\n".join(lines) + "\n", {"odometry": odometry}


DIALECTS = (
    iso_zulu, iso_in_berlin, german_excel, utf16_tabs, byte_order_mark_and_comments, no_header,
    savetxt, quoted, gps_time, clockwise_and_wheels, long_form,
)  # fmt: skip


@pytest.mark.parametrize("dialect", DIALECTS, ids=lambda dialect: dialect.__name__)
def test_odometry_of_every_dialect(dialect: Dialect, tmp_path: Path) -> None:
    road = journey(120)
    log, sections = dialect(road)
    sections["drive"] = {
        "vehicle": {"wheelbase_m": 2.7},
        "frame": {"kind": "local", "name": "here"},
    }
    drive = convert(tmp_path, log, sections)
    assert drive.odometry is not None
    np.testing.assert_allclose(drive.odometry.stamp_s, road.stamp_s, atol=2e-6)
    np.testing.assert_allclose(drive.odometry.speed_mps, road.speed_mps, atol=2e-7)
    np.testing.assert_allclose(drive.odometry.yaw_rate_radps, road.yaw_rate_radps, atol=2e-8)
