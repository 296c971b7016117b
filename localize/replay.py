"""Replays a drive against a map: the content of a run folder, in the order a car would see it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil, floor, nan

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import FrameError, InputError
from polemap.drivelog.merge import SampleRows, merge_streams
from polemap.drivelog.samples import GnssFix, OdometrySample
from polemap.localize.config import LocalizeConfig, for_car
from polemap.localize.localizer import OUTPUT_HOLE_S, Localizer
from polemap.localize.output_trace import OutputTrace, particle_trajectory
from polemap.localize.pose_queue import PoseUpdate
from polemap.map.city.city_map import CityMap
from polemap.map.pole_map import PoleMap
from polemap.vehicle.trajectory import Trajectory

Floats = NDArray[np.float64]
_Input = OdometrySample | GnssFix | Detections


@dataclass(frozen=True, slots=True)
class Run:
    """What one replay gave.

    Attributes:
        pf: the particle filter at every update.
        updates: what became of each of its poses.
        kf: the output filter at every tick of 1 / rate.
        output: per tick: speed, yaw rate, jump (m), age of the last pose used (s).
        flags: per tick, "" in normal operation.
        distrust: per tick, why the output may not be trusted, "" where it may.
        counts: how often what happened, see `Localizer.summary`.
        timings_s: seconds of every call by stage; empty without a clock.
        replay_s: seconds of the whole replay; NaN without a clock.
    """

    pf: Trajectory
    updates: tuple[PoseUpdate, ...]
    kf: Trajectory
    output: Floats
    flags: tuple[str, ...]
    distrust: tuple[str, ...]
    counts: Mapping[str, int]
    timings_s: Mapping[str, Sequence[float]] = field(default_factory=dict)
    replay_s: float = nan


def check_inputs(drive: Drive, pole_map: PoleMap | CityMap | None, *, has_poles: bool) -> None:
    """Refuse what cannot be localized, before any work is done.

    Raises:
        FrameError: map and drive are in different frames.
        InputError: an empty map, or a drive without odometry, poles or GNSS.
    """
    if drive.odometry is None or not len(drive.odometry):
        raise InputError(
            f"drive {drive.name}: it has no odometry; localizing needs {drive.names.odometry}"
        )
    if pole_map is None:
        if drive.gnss is None or not len(drive.gnss):
            raise InputError(f"drive {drive.name}: without poles it needs GNSS, and has none")
        return
    if pole_map.frame != drive.frame:
        raise FrameError(
            f"map is in {pole_map.frame}, drive {drive.name} in {drive.frame}; use a map built in "
            "the drive's frame"
        )
    if not len(pole_map) and not (isinstance(pole_map, PoleMap) and pole_map.lines):
        raise InputError("the map holds no poles; build it from a drive that saw some")
    if not has_poles:
        raise InputError(
            f"drive {drive.name}: it has neither images nor {drive.names.poles}; --without-poles "
            "localizes it by odometry and GNSS alone"
        )


def replay(
    drive: Drive,
    pole_map: PoleMap | CityMap | None,
    scans: Sequence[Detections],
    config: LocalizeConfig,
    *,
    seed: int,
    clock: Callable[[], float] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Run:
    """Replay a drive whose poles have been found.

    A sample counts from its arrival; the particle filter's pose counts from the arrival of its
    scan plus `config.output.processing_delay_s`. The output at a tick knows what came before it.

    Args:
        drive: odometry and GNSS.
        pole_map: in the drive's frame; None for odometry and GNSS alone.
        scans: poles seen, by arrival.
        config: settings; what they leave open comes from the drive's car file.
        seed: of the particle filter.
        clock: monotonic seconds; without it no timings.
        progress: called with the number of samples done since the last call.

    Raises:
        FrameError, InputError: see `check_inputs`.
    """
    check_inputs(drive, pole_map, has_poles=len(scans) > 0)
    config = for_car(config, drive.car)
    updates: list[PoseUpdate] = []
    localizer = Localizer(
        pole_map,
        config,
        drive.wheelbase_m,
        np.random.default_rng(seed),
        gnss_antenna_m=drive.gnss_antenna_m,
        processing_delay_s=config.output.processing_delay_s,
        on_update=updates.append,
        clock=clock,
        load_in_background=False,
    )
    ticks = _Ticks(localizer, config.output.rate_hz)
    begin = clock() if clock else 0.0
    for number, sample in enumerate(_samples(drive, scans if pole_map is not None else ())):
        ticks.up_to(sample.arrival_s)
        localizer.add_sample(sample)
        if progress and number % 1000 == 999:
            progress(1000)
    ticks.finish()
    spent = clock() - begin if clock else nan
    kf, output, flags, distrust = ticks.trace.result()
    timings = localizer.timings_s if clock else {}
    pf = particle_trajectory(updates)
    return Run(pf, tuple(updates), kf, output, flags, distrust, localizer.summary(), timings, spent)


def _samples(drive: Drive, scans: Sequence[Detections]) -> Iterator[_Input]:
    """Odometry, fixes and scans in the order of arrival; odometry first among equals."""
    streams: list[SampleRows[_Input]] = [
        SampleRows(stream.arrival_s, stream.stamp_s, stream.sample)
        for stream in (drive.odometry, drive.gnss)
        if stream is not None
    ]
    arrivals = np.array([scan.arrival_s for scan in scans])
    stamps = np.array([scan.stamp_s for scan in scans])
    return merge_streams([*streams, SampleRows(arrivals, stamps, scans.__getitem__)])


class _Ticks:
    """Asks for the output at every k / rate, as a controller would."""

    def __init__(self, localizer: Localizer, rate_hz: int) -> None:
        self._localizer = localizer
        self._rate = rate_hz
        self._next: int | None = None
        self._last_arrival_s = float("nan")
        self.trace = OutputTrace()

    def up_to(self, arrival_s: float) -> None:
        """Every tick before the arrival of the next sample."""
        if not np.isfinite(arrival_s):
            return
        if self._next is None:
            self._next = ceil(arrival_s * self._rate)
        if arrival_s - self._last_arrival_s > OUTPUT_HOLE_S:
            # time and memory must not depend on how long a recorder was off
            while self._next / self._rate < self._last_arrival_s + OUTPUT_HOLE_S:
                self._ask()
            self._next = ceil(arrival_s * self._rate)
        while self._next / self._rate < arrival_s:
            self._ask()
        self._last_arrival_s = arrival_s

    def finish(self) -> None:
        """The ticks up to the last arrival, that one included."""
        while self._next is not None and self._next <= floor(self._last_arrival_s * self._rate):
            self._ask()

    def _ask(self) -> None:
        assert self._next is not None
        stamp = self._next / self._rate
        self._next += 1
        answer = self._localizer.pose_at(stamp)
        if answer is not None:
            self.trace.append(stamp, answer)
