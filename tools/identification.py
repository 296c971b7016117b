"""`polemap estimate --identify`: a car fitted to logs, what was learned of it, and how it does."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from polemap.drivelog.atomic import atomic_file
from polemap.drivelog.errors import ConfigError
from polemap.electric.identification.fit import Fit, identify, prediction_errors
from polemap.electric.identification.parameters import Sensors
from polemap.electric.signals import SignalLog
from polemap.vehicle.io import dump_car
from polemap.vehicle.parameters import Car

_LEAST_ELSEWHERE_S = 10.0


def identify_car(
    spans: Sequence[SignalLog], elsewhere: Sequence[SignalLog], car: Car, out: Path, source: str
) -> None:
    """Fit, write the car, print the parameters and one JSON line.

    Args:
        spans: what is fitted to.
        elsewhere: rows of the log that are not, to try the result on.
        car: the start.
        out: the car's file.
        source: what the file says of where it is from.
    """
    if out.suffix not in (".yaml", ".yml"):
        raise ConfigError(f"--out {out}: --identify writes a car, name it NAME.yaml")
    fit = identify(spans, car, name=out.stem, source=source)
    with atomic_file(out) as part:
        part.write_text(dump_car(fit.car), "utf-8")
    for line in _table(fit):
        sys.stderr.write(line + "\n")
    told = {
        "car": fit.car.name,
        **_named(fit.left),
        "rows": fit.rows,
        "at_bound": [p.name for p in fit.parameters if p.at_bound],
        "open": [p.name for p in fit.parameters if p.open],
    }
    seconds = sum(float(np.ptp(log.stamp_s)) for log in elsewhere)
    if seconds >= _LEAST_ELSEWHERE_S:
        ours = prediction_errors((fit.car, fit.sensors), elsewhere)
        start = prediction_errors((car, Sensors()), elsewhere)
        told["elsewhere"] = {**_named(ours), "of_the_start": _named(start)}
        worse = [name for name, value in ours.items() if value > start[name]]
        if worse:
            sys.stderr.write(
                f"warning: on the rest of the log the fitted car predicts {', '.join(worse)} worse "
                "than the one it started from; choose a span with more kinds of driving\n"
            )
    else:
        sys.stderr.write("note: no ten seconds of the log are left to try the fitted car on\n")
    sys.stdout.write(json.dumps(told) + "\n")


def _table(fit: Fit) -> list[str]:
    lines = []
    for p in fit.parameters:
        said = ""
        if p.at_bound:
            said = "  AT ITS BOUND: not to be trusted"
        elif p.open:
            said = "  hardly told by this log"
        lines.append(
            f"{p.name:<24} {p.value:>10.5g} +- {p.sd:<8.2g} before {p.start:>10.5g} +- "
            f"{p.prior_sd:<8.2g}{said}"
        )
    return lines


def _named(errors: dict[str, float]) -> dict[str, float]:
    """Root mean squares under the names that the other JSON lines have."""
    named = {}
    if "sideslip_rad" in errors:
        named["sideslip_rmse_deg"] = round(float(np.degrees(errors["sideslip_rad"])), 5)
    named["yaw_rate_rmse_radps"] = round(errors["yaw_rate_radps"], 6)
    if "ay_mps2" in errors:
        named["ay_rmse_mps2"] = round(errors["ay_mps2"], 5)
    return named
