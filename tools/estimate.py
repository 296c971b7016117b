"""`polemap estimate`: side-slip and velocity estimators on a signal log."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from pydantic import ValidationError

from polemap.drivelog.atomic import atomic_file, check_file
from polemap.drivelog.errors import ConfigError, InputError
from polemap.drivelog.logs.nmea import read_nmea
from polemap.electric.clock_rate import StretchedClock, stretched_clock
from polemap.electric.comma2k19.io import is_comma2k19, read_comma2k19
from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import GPS
from polemap.electric.estimators.registry import known_estimators
from polemap.electric.gaps import find_gaps, settled
from polemap.electric.io import gps_from_truth, read_signal_log
from polemap.electric.lanes import camera_settings
from polemap.electric.plausibility import check_log
from polemap.electric.receiver import join_receiver
from polemap.electric.signals import Played, SignalLog
from polemap.electric.watched import Record
from polemap.set_option import parse_set_option
from polemap.settings import first_problem, read_tree
from polemap.tools.estimator_run import run_estimator, tell_faults
from polemap.tools.findings import require_plausible
from polemap.tools.identification import identify_car
from polemap.tools.lanes import drive_signals
from polemap.tools.option_types import ForceOption, PageOption, page_possible
from polemap.vehicle.io import car_names, load_car
from polemap.vehicle.motion import sideslip_at
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]
SETTLED_S = 2.0
"""Scoring starts this long after the first row and after a gap: no filter knows its start."""


def command(
    log: Annotated[
        Path | None,
        typer.Argument(help="CSV, Parquet or MCAP log, a drive with signals.csv, or comma2k19."),
    ] = None,
    estimator: Annotated[str | None, typer.Option("--estimator", help="See --list.")] = None,
    vehicle: Annotated[
        str | None, typer.Option("--vehicle", help="Name of a car, see --list, or a YAML file.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Estimates (.csv); with --identify the car (.yaml)."),
    ] = None,
    mapping: Annotated[
        Path | None, typer.Option("--mapping", help="YAML file: known name to column of the log.")
    ] = None,
    span: Annotated[
        str | None, typer.Option("--span", help="Use only stamps A:B of the log, seconds.")
    ] = None,
    identify_span: Annotated[
        str | None,
        typer.Option("--identify", help="Fit the car on stamps A:B[,C:D...] instead."),
    ] = None,
    also: Annotated[
        list[Path] | None,
        typer.Option("--also", help="With --identify: a further log of the same car, used whole."),
    ] = None,
    gps: Annotated[
        Path | None,
        typer.Option("--gps", help="NMEA 0183 log of a receiver: its fixes join the LOG."),
    ] = None,
    derive_gps: Annotated[
        bool,
        typer.Option(
            "--derive-gps", help="Make 5 Hz GPS, 100 ms late, from the reference; seeded noise."
        ),
    ] = False,
    config_file: Annotated[
        Path | None, typer.Option("--config", help="YAML file of estimator settings.")
    ] = None,
    set_values: Annotated[
        list[str] | None, typer.Option("--set", help="One setting, such as gyro_sd_radps=0.01.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the derived GPS noise.")] = 0,
    page: PageOption = True,
    force: ForceOption = False,
    listed: Annotated[bool, typer.Option("--list", help="List estimators and cars.")] = False,
) -> None:
    """Run a side-slip or velocity estimator on a signal log.

    Late values come when their arrival column says. Columns that are not known are ignored with
    a note. With a side-slip reference in the log, or where a sensor was found faulty, one JSON
    line goes to stdout: errors, which count from two seconds after the first row, and faults. A
    page of pictures (NAME.html) goes beside --out.

    Examples:
        polemap estimate --list
        polemap estimate log.csv --estimator clones --vehicle coms --out estimate.csv
        polemap estimate log.parquet --mapping names.yaml --estimator bicycle --vehicle passat \\
            --out estimate.csv
        polemap estimate comma2k19/ --estimator two_layer --vehicle rav4 --out estimate.csv \\
            --set gps_slots=3 --set heading_walk_rad=0.01
        polemap estimate DRIVE --estimator clones --vehicle passat --out estimate.csv
        polemap estimate log.csv --identify 150:250 --vehicle 250lm_published --out 250lm.yaml
        polemap estimate a.csv --identify 0:60,90:120 --also b.csv --vehicle passat --out mine.yaml
    """
    if listed:
        _list()
        return
    if log is None or vehicle is None or out is None:
        raise ConfigError("estimate needs a LOG, --vehicle and --out; --list names the cars")
    kinds = (".yaml", ".yml") if identify_span is not None else (".csv",)
    check_file(out, (log, vehicle, mapping, config_file, gps, *(also or [])), kinds)
    car = load_car(vehicle)
    signals, scored_from_s = _read(log, mapping, car)
    if gps is not None:
        signals = _with_receiver(signals, gps)
    if span is not None:
        signals = _cut(signals, span, "--span")
    require_plausible(log.name, check_log(signals, car), force=force)
    if identify_span is not None:
        source = (
            f"polemap estimate {log.name} --identify {identify_span} --vehicle {vehicle}: tyres, "
            "yaw inertia, load transfer, steering and side-slip point fitted; the rest from "
            f"{vehicle} ({car.source})"
        )
        spans, rest = _parts(signals, identify_span)
        for other in also or []:
            further, _ = _read(other, mapping, car)
            require_plausible(other.name, check_log(further, car), force=force)
            spans.append(further)
        spans, rest = [[_in_real_time(part) for part in parts] for parts in (spans, rest)]
        identify_car(spans, rest, car, out, source)
        return
    if also:
        raise ConfigError("--also goes with --identify")
    if estimator is None or estimator not in known_estimators():
        raise ConfigError(f"--estimator {estimator}: choose one of {', '.join(known_estimators())}")
    clock = stretched_clock(signals)
    heard = signals if clock is None else clock.real_time(signals)
    config = load_estimator_config(config_file, set_values, heard, camera_settings(heard))
    if derive_gps:
        heard = _with_gps(heard, config, seed)
        # the antenna of a GPS that is made from the reference sits where the reference does
        car = replace(car, gps_point_m=car.sideslip_point_m)
    shown = out.with_suffix(".html") if page and page_possible() else None
    if shown is not None:
        check_file(shown, (log, vehicle, mapping, config_file, out), (".html",))
    record = None if shown is None else Record()
    played, faults = run_estimator(estimator, heard, car, config, log, record)
    in_time = played
    if clock is not None:
        played = clock.at_rows(played, signals)
    write_estimates(played, out)
    scores = score(estimator, played, signals, car, scored_from_s)
    told = tell_faults(faults, clock, float(signals.stamp_s[0]))
    if told:
        scores = {"estimator": estimator, **scores, "faults": told}
    if scores:
        sys.stdout.write(json.dumps(scores) + "\n")
    if shown is not None and record is not None:
        # a stretched clock's page is in real time, as the estimator ran
        write_page(shown, estimator, car, heard, in_time, record, scores)


def write_page(
    out: Path,
    estimator: str,
    car: Car,
    log: SignalLog,
    played: Played,
    record: Record,
    scores: dict[str, object],
) -> None:
    """The page beside the estimates."""
    # matplotlib is an extra: only who wants the page imports it
    from polemap.tools.report.signals_page import estimate_section, render_signals

    slip = None
    if log.has("sideslip_rad") and "sideslip_rad" in played.fields:
        slip = at_reference(estimator, played, log, car)
    section = estimate_section(estimator, log, played, slip, record, scores)
    with atomic_file(out) as part:
        part.write_text(render_signals(section.title, [section]), encoding="utf-8")
    sys.stderr.write(f"wrote {out}\n")


def _with_gps(signals: SignalLog, config: EstimatorConfig, seed: int) -> SignalLog:
    made = gps_from_truth(
        signals,
        np.random.default_rng(seed),
        course_sd_rad=config.course_sd_rad,
        speed_sd_mps=config.speed_sd_mps,
    )
    sys.stderr.write("note: GPS is derived from the reference with seeded noise, not real\n")
    return made


def _with_receiver(signals: SignalLog, path: Path) -> SignalLog:
    fixes = read_nmea(path)
    try:
        joined = join_receiver(signals, fixes.columns)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    sys.stderr.write(
        f"note: {path.name}: {fixes.says}; {joined.fixes} fixes join the log, "
        f"{joined.offset_s:.2f} s added to their stamps, {joined.from_positions} courses from "
        f"positions, {joined.left_out} left out for their HDOP\n"
    )
    return joined.log


def _read(log: Path, mapping: Path | None, car: Car) -> tuple[SignalLog, float]:
    """The log, and the stamp up to which its reference was used and is not to be scored."""
    if is_comma2k19(log):
        segment = read_comma2k19(log, car.steering_ratio)
        yaw, pitch = np.degrees([segment.mount_yaw_rad, segment.mount_pitch_rad])
        sys.stderr.write(
            f"note: mount yaw {yaw:.2f} and pitch {pitch:.2f} degrees from the reference up to "
            f"{segment.mount_until_s:.1f} s, scored from there; GNSS {segment.gnss_delay_s:.3f} s "
            "late\n"
        )
        return segment.log, segment.mount_until_s
    if log.is_dir():
        return drive_signals(log, car), float("-inf")
    signals, ignored = read_signal_log(log, mapping)
    if ignored:
        sys.stderr.write(f"note: ignored columns {', '.join(ignored)}\n")
    return signals, float("-inf")


def load_estimator_config(
    config_file: Path | None,
    set_values: list[str] | None,
    signals: SignalLog,
    known: dict[str, float] | None = None,
) -> EstimatorConfig:
    """Settings: the defaults, the log's own step, what is `known`, then the file, then `--set`.

    Raises:
        ConfigError: an unknown key or a value out of range.
    """
    tree: dict[str, object] = {"step_s": round(float(np.median(np.diff(signals.stamp_s))), 6)}
    tree.update(known or {})
    if config_file is not None:
        tree.update(read_tree(config_file))
    tree.update(parse_set_option(item, "gyro_sd_radps=0.01") for item in set_values or [])
    try:
        return EstimatorConfig.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(f"settings: {first_problem(error, EstimatorConfig)}") from error


def at_reference(name: str, played: Played, signals: SignalLog, car: Car) -> Floats:
    """Side-slip `(n,)` where the reference measures it.

    A model's side-slip is that of the centre of gravity; one that hears GPS is the antenna's.
    """
    slip = played.column("sideslip_rad")
    if GPS in known_estimators()[name].late or "yaw_rate_radps" not in played.fields:
        return slip
    speed = np.maximum(signals.held("vx_mps"), 1.0)
    return np.asarray(
        sideslip_at(slip, played.column("yaw_rate_radps"), speed, car.sideslip_point_m)
    )


def score(
    name: str, played: Played, signals: SignalLog, car: Car, from_s: float = float("-inf")
) -> dict[str, object]:
    """Errors against the reference of the log from `from_s` on; empty without one."""
    result: dict[str, object] = {}
    late = settled(played.stamp_s, find_gaps(signals), SETTLED_S) & (played.stamp_s >= from_s)
    if signals.has("sideslip_rad"):
        truth = signals.columns["sideslip_rad"]
        slip = at_reference(name, played, signals, car)
        scored = late & np.isfinite(truth)
        # a side-slip beyond a right angle is no estimate, and none may be left out of a figure
        failed = scored & ~(np.abs(slip) < np.pi / 2.0)
        error = np.degrees((slip - truth)[scored & ~failed])
        if scored.any():
            result = {"estimator": name, "sideslip_rmse_deg": None, "sideslip_p95_deg": None}
            if failed.any():
                result["rows_not_estimated"] = int(failed.sum())
            else:
                result["sideslip_rmse_deg"] = round(float(np.sqrt(np.mean(error**2))), 5)
                result["sideslip_p95_deg"] = round(float(np.percentile(np.abs(error), 95)), 5)
                stated = np.degrees(played.sd_of("sideslip_rad")[scored])
                if (stated > 0.0).all():
                    result["sideslip_nees"] = round(float(np.mean((error / stated) ** 2)), 4)
    for field, reference in (("vx_mps", "vx_reference_mps"), ("vy_mps", "vy_mps")):
        if not signals.has(reference) or field not in played.fields:
            continue
        truth = signals.columns[reference]
        scored = late & np.isfinite(truth)
        error = (played.column(field) - truth)[scored]
        if len(error):
            result.setdefault("estimator", name)
            if not np.isfinite(error).all():
                result["rows_not_estimated"] = int(np.count_nonzero(~np.isfinite(error)))
                continue
            stem = field.removesuffix("_mps")
            result[f"{stem}_rmse_mps"] = round(float(np.sqrt(np.mean(error**2))), 5)
            result[f"{stem}_p95_mps"] = round(float(np.percentile(np.abs(error), 95)), 5)
    return result


def write_estimates(played: Played, out: Path) -> None:
    """The estimates as CSV, every field followed by its standard deviation."""
    import pandas as pd  # slow to import

    columns: dict[str, Floats] = {"stamp_s": played.stamp_s}
    for name in played.fields:
        stem, _, unit = name.rpartition("_")
        columns[name] = played.column(name)
        deviation = f"{name}_sd" if unit == "scale" else f"{stem}_sd_{unit}"
        columns[deviation] = played.sd_of(name)
    with atomic_file(out) as part:
        pd.DataFrame(columns).to_csv(part, index=False, float_format="%.9g")


def _in_real_time(signals: SignalLog) -> SignalLog:
    clock: StretchedClock | None = stretched_clock(signals)
    return signals if clock is None else clock.real_time(signals)


def _parts(signals: SignalLog, spans: str) -> tuple[list[SignalLog], list[SignalLog]]:
    """The spans `A:B,C:D` of a log, and what lies between and around them."""
    inside, taken = [], np.zeros(len(signals), dtype=bool)
    for span in spans.split(","):
        part = _cut(signals, span, "--identify")
        inside.append(part)
        taken |= (signals.stamp_s >= part.stamp_s[0]) & (signals.stamp_s <= part.stamp_s[-1])
    edges = np.flatnonzero(np.diff(taken.astype(np.int8), prepend=1, append=1))
    rest = []
    for first, after in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if after - first >= 2:
            end = signals.stamp_s[after] if after < len(signals) else float("inf")
            rest.append(signals.between(signals.stamp_s[first], end))
    return inside, rest


def _cut(signals: SignalLog, span: str, option: str) -> SignalLog:
    first, colon, last = span.partition(":")
    try:
        start, end = float(first or "-inf"), float(last or "inf")
    except ValueError as error:
        raise ConfigError(
            f"{option} {span}: give two stamps in seconds, such as 150:250"
        ) from error
    if not colon or not start < end:
        raise ConfigError(f"{option} {span}: give two stamps in seconds, such as 150:250")
    inside = (signals.stamp_s >= start) & (signals.stamp_s < end)
    if inside.sum() < 2:
        raise ConfigError(
            f"{option} {span}: the log runs from {signals.stamp_s[0]} to {signals.stamp_s[-1]} s"
        )
    return signals.between(start, end)


def _list() -> None:
    lines = ["estimators:"]
    for name, entry in known_estimators().items():
        lines.append(f"  {name:<24} {entry.summary}")
    lines.append("cars:")
    for name in car_names():
        car = load_car(name)
        lines.append(f"  {name:<24} {car.mass_kg:.0f} kg, wheelbase {car.wheelbase_m:.2f} m")
    sys.stdout.write("\n".join(lines) + "\n")
