"""A log through an estimator by its name, and the faults of sensors that were found on the way."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from polemap.drivelog.errors import InputError
from polemap.electric import watched
from polemap.electric.clock_rate import StretchedClock
from polemap.electric.config import EstimatorConfig
from polemap.electric.estimators.base import Estimator
from polemap.electric.estimators.registry import known_estimators, make_estimator
from polemap.electric.gaps import play_parts
from polemap.electric.isolation.suspicion import Fault
from polemap.electric.isolation.tolerant import FaultTolerant
from polemap.electric.signals import Played, SignalLog
from polemap.electric.watched import Record, Watched
from polemap.tools.progress import progress
from polemap.vehicle.parameters import Car

INNOVATIONS = 4000
"""Of the gyro so many are looked at for the page."""
_TOLD_MOST = 20


def run_estimator(
    name: str,
    signals: SignalLog,
    car: Car,
    config: EstimatorConfig,
    place: Path,
    record: Record | None = None,
) -> tuple[Played, list[Fault]]:
    """Play a log to an estimator, with a progress bar; `record` takes what it heard.

    Returns:
        What it said, and the faults of sensors, none where `isolate_faults` is off.

    Raises:
        InputError: the log lacks a sensor that the estimator lives on.
    """
    entry, kinds = known_estimators()[name], signals.kinds()
    missing = [kind for kind in entry.needs if kind not in kinds]
    if missing or (entry.late and not kinds.intersection(entry.late)):
        lacking = missing[0] if missing else " or ".join(entry.late)
        raise InputError(f"{place}: {name} needs {lacking} and the log has no such signal")
    every = max(1, len(signals) // INNOVATIONS)
    faults: list[Fault] = []

    def make() -> Estimator:
        made = make_estimator(name, car, config)
        if config.isolate_faults:
            made = FaultTolerant(made, car, config, entry.needs, faults)
        return made if record is None else Watched(made, config, record, every)

    with progress(len(signals), f"{name}") as advance:
        played, dropped = play_parts(
            make,
            signals,
            steering_offset_rad=car.steering_offset_rad,
            steering_scale=car.steering_scale,
            steering_delay_s=car.steering_delay_s,
            progress=advance,
        )
    for reason, count in dropped.items():
        sys.stderr.write(f"note: {count} times: {reason}\n")
    if record is not None:
        record.faults += [
            watched.Fault(fault.sensor, fault.what, fault.from_s, fault.to_s, fault.withheld)
            for fault in faults
        ]
    return played, faults


def tell_faults(
    faults: Sequence[Fault], clock: StretchedClock | None, start_s: float
) -> list[dict[str, object]]:
    """Faults for JSON, in the log's own stamps; each is a line on the terminal too."""

    def own(stamp_s: float) -> float:
        return round(start_s + (stamp_s - start_s) * (clock.times if clock else 1), 3)

    for fault in faults[:_TOLD_MOST]:
        sys.stderr.write(
            f"fault: {fault.sensor}: {fault.what}, {own(fault.from_s):.2f} to "
            f"{own(fault.to_s):.2f} s, {fault.withheld} values withheld\n"
        )
    if len(faults) > _TOLD_MOST:
        sys.stderr.write(f"fault: {len(faults) - _TOLD_MOST} more, see the page\n")
    return [
        {
            "sensor": fault.sensor,
            "what": fault.what,
            "from_s": own(fault.from_s),
            "found_s": own(fault.found_s),
            "to_s": own(fault.to_s),
            "withheld": fault.withheld,
        }
        for fault in faults
    ]
