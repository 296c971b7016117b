"""The log of `polemap estimate`: where it is from, GPS that joins it, spans of it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from polemap.drivelog.errors import ConfigError, InputError
from polemap.drivelog.logs.nmea import read_nmea
from polemap.electric.clock_rate import StretchedClock, stretched_clock
from polemap.electric.comma2k19.io import is_comma2k19, read_comma2k19
from polemap.electric.config import EstimatorConfig
from polemap.electric.io import gps_from_truth, read_signal_log
from polemap.electric.receiver import join_receiver
from polemap.electric.signals import SignalLog
from polemap.tools.lanes import drive_signals
from polemap.vehicle.parameters import Car


def with_derived_gps(signals: SignalLog, config: EstimatorConfig, seed: int) -> SignalLog:
    made = gps_from_truth(
        signals,
        np.random.default_rng(seed),
        course_sd_rad=config.course_sd_rad,
        speed_sd_mps=config.speed_sd_mps,
    )
    sys.stderr.write("note: GPS is derived from the reference with seeded noise, not real\n")
    return made


def with_receiver(signals: SignalLog, path: Path) -> SignalLog:
    # a log without dates is of any day: its clock is brought to the log's by the speed
    fixes = read_nmea(path, day="1970-01-01")
    try:
        joined = join_receiver(signals, fixes.columns)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    lost = "".join(f", {count} {what}" for what, count in fixes.dropped.items())
    sys.stderr.write(
        f"note: {path.name}: {fixes.says}{lost}; {joined.fixes} fixes join the log, "
        f"{joined.offset_s:.2f} s added to their stamps, {joined.from_positions} courses from "
        f"positions, {joined.left_out} left out for their HDOP\n"
    )
    return joined.log


def read_signals(log: Path, mapping: Path | None, car: Car) -> tuple[SignalLog, float]:
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


def in_real_time(signals: SignalLog) -> SignalLog:
    clock: StretchedClock | None = stretched_clock(signals)
    return signals if clock is None else clock.real_time(signals)


def split_spans(signals: SignalLog, spans: str) -> tuple[list[SignalLog], list[SignalLog]]:
    """The spans `A:B,C:D` of a log, and what lies between and around them."""
    inside, taken = [], np.zeros(len(signals), dtype=bool)
    for span in spans.split(","):
        part = cut_span(signals, span, "--identify")
        inside.append(part)
        taken |= (signals.stamp_s >= part.stamp_s[0]) & (signals.stamp_s <= part.stamp_s[-1])
    edges = np.flatnonzero(np.diff(taken.astype(np.int8), prepend=1, append=1))
    rest = []
    for first, after in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if after - first >= 2:
            end = signals.stamp_s[after] if after < len(signals) else float("inf")
            rest.append(signals.between(signals.stamp_s[first], end))
    return inside, rest


def cut_span(signals: SignalLog, span: str, option: str) -> SignalLog:
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
