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
from polemap.drivelog.errors import ConfigError
from polemap.electric.clock_rate import stretched_clock
from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.registry import known_estimators
from polemap.electric.fix_noise import with_fix_noise
from polemap.electric.lanes import camera_settings
from polemap.electric.plausibility import check_log
from polemap.electric.signals import Played, SignalLog
from polemap.electric.watched import Record
from polemap.set_option import parse_set_option
from polemap.settings import first_problem, read_tree
from polemap.tools.estimate_input import (
    cut_span,
    in_real_time,
    read_signals,
    split_spans,
    with_derived_gps,
    with_receiver,
)
from polemap.tools.estimate_scores import at_reference, score
from polemap.tools.estimator_run import run_estimator, tell_faults
from polemap.tools.findings import require_plausible
from polemap.tools.identification import identify_car
from polemap.tools.option_types import ForceOption, PageOption, page_possible
from polemap.vehicle.io import car_names, load_car
from polemap.vehicle.parameters import Car

Floats = NDArray[np.float64]


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
    signals, scored_from_s = read_signals(log, mapping, car)
    if gps is not None:
        signals = with_receiver(signals, gps)
    if span is not None:
        signals = cut_span(signals, span, "--span")
    require_plausible(log.name, check_log(signals, car), force=force)
    if identify_span is not None:
        source = (
            f"polemap estimate {log.name} --identify {identify_span} --vehicle {vehicle}: tyres, "
            "yaw inertia, load transfer, steering and side-slip point fitted; the rest from "
            f"{vehicle} ({car.source})"
        )
        spans, rest = split_spans(signals, identify_span)
        for other in also or []:
            further, _ = read_signals(other, mapping, car)
            require_plausible(other.name, check_log(further, car), force=force)
            spans.append(further)
        spans, rest = [[in_real_time(part) for part in parts] for parts in (spans, rest)]
        identify_car(spans, rest, car, out, source)
        return
    if also:
        raise ConfigError("--also goes with --identify")
    if estimator is None or estimator not in known_estimators():
        raise ConfigError(f"--estimator {estimator}: choose one of {', '.join(known_estimators())}")
    clock = stretched_clock(signals)
    heard = signals if clock is None else clock.real_time(signals)
    config = load_estimator_config(config_file, set_values, heard, camera_settings(heard))
    heard = with_fix_noise(heard, config)
    if derive_gps:
        heard = with_derived_gps(heard, config, seed)
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


def _list() -> None:
    lines = ["estimators:"]
    for name, entry in known_estimators().items():
        lines.append(f"  {name:<24} {entry.summary}")
    lines.append("cars:")
    for name in car_names():
        car = load_car(name)
        lines.append(f"  {name:<24} {car.mass_kg:.0f} kg, wheelbase {car.wheelbase_m:.2f} m")
    sys.stdout.write("\n".join(lines) + "\n")
