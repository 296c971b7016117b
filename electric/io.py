"""Signal logs on disk: CSV, Parquet or MCAP (JSON messages)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import ConfigError, InputError
from polemap.electric.signals import (
    CAMERA_SPREAD_COLUMNS,
    INPUT_COLUMNS,
    REFERENCE_COLUMNS,
    SignalLog,
)
from polemap.errors import PolemapError
from polemap.extras import need
from polemap.parsing.csv_text import check_csv
from polemap.parsing.errors import ParsingError, named, short
from polemap.parsing.json_text import parse_json
from polemap.parsing.text import decoded
from polemap.parsing.yaml_text import read_yaml
from polemap.vehicle.errors import VehicleError

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]
KNOWN = ("stamp_s", *INPUT_COLUMNS, *CAMERA_SPREAD_COLUMNS, *REFERENCE_COLUMNS)


def read_signal_log(path: Path, mapping: Path | None = None) -> tuple[SignalLog, list[str]]:
    """The log and the names of the columns that were ignored.

    Raises:
        InputError: a file that cannot be read, a missing column, a cell that is not a number or
            stamps that do not grow; the message names the place.
        ConfigError: a mapping file that cannot be used.
    """
    table = _read_table(path)
    if mapping is not None:
        table = _renamed(table, read_mapping(mapping), path)
    if "stamp_s" not in table.columns:
        raise InputError(f"{path}: no column stamp_s; name it there or give a --mapping file")
    doubled = table.columns[table.columns.duplicated()]
    if len(doubled):
        raise InputError(f"{path}: column {doubled[0]} stands there twice")
    ignored = [str(name) for name in table.columns if name not in KNOWN]
    columns = {str(n): _numbers(table[n], str(n), path) for n in table.columns if n in KNOWN}
    stamps = columns.pop("stamp_s")
    try:
        return SignalLog(stamps, columns), ignored
    except VehicleError as error:
        raise InputError(f"{path}: {error}") from error


def read_mapping(path: Path) -> dict[str, tuple[str, float]]:
    """Known name to the file's column and a factor: `vx_mps: speed` or `{column: v, scale: 0.278}`.

    Raises:
        ConfigError: not a mapping of known names.
    """
    with named(path, ConfigError, "mapping file"):
        tree = read_yaml(path)
    if not isinstance(tree, dict):
        raise ConfigError(f"{path}: a mapping file holds `known_name: column` lines")
    result = {}
    for name, value in tree.items():
        if name not in KNOWN:
            raise ConfigError(f"{path}: {name} is no known signal; known are {', '.join(KNOWN)}")
        if isinstance(value, dict):
            extra = set(value) - {"column", "scale"}
            scale = value.get("scale", 1.0)
            if extra or "column" not in value or not isinstance(scale, int | float):
                raise ConfigError(f"{path}: {name} takes `column` and a number `scale`")
            result[name] = (str(value["column"]), float(scale))
        else:
            result[name] = (str(value), 1.0)
    return result


def _read_table(path: Path) -> pd.DataFrame:
    import pandas as pd  # slow to import

    if not path.exists():
        raise InputError(f"{path}: no such file")
    try:
        if path.suffix == ".parquet":
            need("pyarrow")
            return pd.read_parquet(path)
        if path.suffix == ".mcap":
            return _read_mcap(path)
        check_csv(path)
        return pd.read_csv(path, skipinitialspace=True)
    except ParsingError as error:
        raise InputError(f"{path}: {error}") from error
    except PolemapError:
        raise
    except Exception as error:  # pandas and pyarrow raise whatever they meet
        raise InputError(f"{path}: cannot be read as a signal log ({short(error)})") from error


def _read_mcap(path: Path) -> pd.DataFrame:
    """JSON messages of all channels; a field `f` of topic `/t` is the column `/t.f`.

    Fields of known names keep them. The stamp is the message's own `stamp_s`, else its log time.
    """
    import pandas as pd

    rows = []
    with path.open("rb") as stream:
        for _schema, channel, message in need("mcap.reader").make_reader(stream).iter_messages():
            if channel.message_encoding != "json":
                continue
            content = parse_json(decoded(message.data))
            if not isinstance(content, dict):
                raise InputError(f"{path}: a message of {channel.topic} is no object of values")
            row = {"stamp_s": content.pop("stamp_s", message.log_time * 1e-9)}
            for name, value in content.items():
                if isinstance(value, int | float):
                    row[name if name in KNOWN else f"{channel.topic}.{name}"] = value
            rows.append(row)
    if not rows:
        raise InputError(f"{path}: holds no JSON messages; ROS messages are not read here")
    return pd.DataFrame(rows).groupby("stamp_s", as_index=False).first()


def _renamed(
    table: pd.DataFrame, mapping: dict[str, tuple[str, float]], path: Path
) -> pd.DataFrame:
    import pandas as pd

    taken = {column for column, _ in mapping.values()}
    result = table[[c for c in table.columns if c not in taken and c not in mapping]].copy()
    for name, (column, scale) in mapping.items():
        if column not in table.columns:
            raise InputError(f"{path}: no column {column}, which the mapping calls {name}")
        values = table[column]
        result[name] = values if scale == 1.0 else pd.to_numeric(values, errors="coerce") * scale
    return result


def _numbers(column: pd.Series[Any], name: str, path: Path) -> Floats:
    import pandas as pd

    numbers = pd.to_numeric(column, errors="coerce")
    wrong = numbers.isna() & column.notna()
    if wrong.any():  # text is looked at only where something is not a number: long logs are slow
        wrong &= column.astype(str).str.lower() != "nan"
    if wrong.any():
        row = int(np.flatnonzero(wrong.to_numpy())[0])
        raise InputError(
            f"{path}: row {row + 2}, {name}: {repr(column.iloc[row])[:60]} is not a number"
        )
    values = numbers.to_numpy(dtype=np.float64)
    if np.isinf(values).any():
        row = int(np.flatnonzero(np.isinf(values))[0])
        raise InputError(f"{path}: row {row + 2}, {name}: infinite")
    return np.asarray(values, dtype=np.float64)


def gps_from_truth(
    log: SignalLog,
    rng: np.random.Generator,
    *,
    rate_hz: float = 5.0,
    delay_s: float = 0.1,
    course_sd_rad: float,
    speed_sd_mps: float,
) -> SignalLog:
    """A log with the GPS that its car did not have: course and speed from the reference.

    Course is the integral of the yaw rate plus the true side-slip; noise is white.

    Raises:
        InputError: no side-slip reference to derive it from.
    """
    for needed in ("sideslip_rad", "yaw_rate_radps", "vx_mps"):
        if not log.has(needed):
            raise InputError(f"GPS cannot be derived without the column {needed}")
    stamps, n = log.stamp_s, len(log)
    yaw_rate, slip, vx = (log.held(c) for c in ("yaw_rate_radps", "sideslip_rad", "vx_mps"))
    heading = np.concatenate([[0.0], np.cumsum(yaw_rate[:-1] * np.diff(stamps))])
    ticks = np.floor((stamps - stamps[0]) * rate_hz + 1e-6)
    rows = np.flatnonzero(np.diff(ticks, prepend=-1.0) > 0.0)
    course, speed, arrival = (np.full(n, np.nan) for _ in range(3))
    course[rows] = heading[rows] + slip[rows] + course_sd_rad * rng.standard_normal(len(rows))
    speed[rows] = vx[rows] / np.cos(slip[rows]) + speed_sd_mps * rng.standard_normal(len(rows))
    arrival[rows] = stamps[rows] + delay_s
    columns = {**log.columns, "course_rad": course, "speed_mps": speed, "gnss_arrival_s": arrival}
    return SignalLog(stamps, columns)
