"""Where a drive leads over the street: laps, and U-turns that go back a part of one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.errors import ConfigError
from polemap.simulate.route import Route
from polemap.simulate.scenario import DriveSpec, UTurnSpec

Floats = NDArray[np.float64]
GRID_M = 0.25
_FINE_M = 0.05
# length over which the car leaves its lane before a U-turn, and finds into one after it
_SWING_M = 14.0


@dataclass(frozen=True, slots=True)
class Way:
    """The line that the car is to follow without wander, every 0.25 m; every array `(n,)`.

    Attributes:
        station_m: along the street, growing over the laps, falling on the way back.
        lateral_m: left of the street's centre line.
        bend_1pm: curvature on top of the street's own, not negative.
        lap_starts_m: `(laps + 1,)` length driven at each lap's start and at the end.
    """

    station_m: Floats
    lateral_m: Floats
    bend_1pm: Floats
    lap_starts_m: Floats

    @property
    def driven_m(self) -> Floats:
        """Length of the way up to each point."""
        return GRID_M * np.arange(len(self.station_m), dtype=np.float64)

    def reached_m(self, station_m: float) -> float:
        """Length driven when a place is first reached."""
        furthest = np.maximum.accumulate(self.station_m)
        row = int(np.searchsorted(furthest, station_m - 1e-6))
        return GRID_M * min(row, len(furthest) - 1)


def make_way(route: Route, spec: DriveSpec, laps: int) -> Way:
    """The way of some laps; an open route ends 2 m before its end.

    Raises:
        ConfigError: several laps of an open route, or a U-turn beyond the ends of the street or
            into another.
    """
    if laps > 1 and not route.closed:
        raise ConfigError(f"--laps {laps}: the route of this world is open, it has one lap only")
    length = route.length_m
    end = laps * length - (0.0 if route.closed else 4.0)
    turns = sorted(spec.u_turns, key=lambda turn: turn.at_m)
    if not turns:
        station = np.arange(0.0, end + GRID_M, GRID_M)
        lateral = np.full(len(station), spec.lane_offset_m)
        starts = np.minimum(np.arange(laps + 1) * length, end)
        return Way(station, lateral, np.zeros(len(station)), starts)
    _check(turns, length)
    pieces = [np.array([[0.0, spec.lane_offset_m]])]
    for lap in range(laps):
        for turn in turns:
            pieces += _there_and_back(turn, lap * length, spec.lane_offset_m)
    pieces.append(np.array([[end, spec.lane_offset_m]]))
    line = np.concatenate(pieces)
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    grid = np.arange(0.0, driven[-1] + GRID_M, GRID_M)
    station, lateral = (np.interp(grid, driven, line[:, k]) for k in (0, 1))
    heading = np.unwrap(np.arctan2(np.gradient(lateral), np.gradient(station)))
    way = Way(station, lateral, np.abs(np.gradient(heading, GRID_M)), np.zeros(0))
    starts = [way.reached_m(min(lap * length, end)) for lap in range(laps + 1)]
    return Way(station, lateral, way.bend_1pm, np.array(starts))


def _check(turns: list[UTurnSpec], length_m: float) -> None:
    free = 0.0
    for turn in turns:
        reach = turn.radius_m + _SWING_M
        if turn.back_to_m - reach < free or turn.at_m + turn.radius_m > length_m - _SWING_M:
            raise ConfigError(
                f"drive.u_turns: the turn at {turn.at_m:g} m back to {turn.back_to_m:g} m leaves "
                f"the street of {length_m:.0f} m or meets the turn before it; move it"
            )
        free = turn.at_m + _SWING_M


def _there_and_back(turn: UTurnSpec, lap_m: float, lane_m: float) -> list[Floats]:
    """Points (station, lateral) of a turn, the way back in the other lane, and the turn again."""
    near = np.sign(lane_m) or -1.0
    wide, at, back = near * turn.radius_m, lap_m + turn.at_m, lap_m + turn.back_to_m
    angle = np.arange(0.0, np.pi, _FINE_M / turn.radius_m)
    bow = turn.radius_m * np.sin(angle)
    half = wide * np.cos(angle)
    return [
        _swing(at - _SWING_M, at, lane_m, wide),
        np.column_stack([at + bow, half]),
        _swing(at, at - _SWING_M, -wide, -lane_m),
        _swing(back + _SWING_M, back, -lane_m, -wide),
        np.column_stack([back - bow, -half]),
        _swing(back, back + _SWING_M, wide, lane_m),
    ]


def _swing(start_m: float, end_m: float, left_m: float, right_m: float) -> Floats:
    """A soft change from one lateral position to another."""
    share = np.linspace(0.0, 1.0, int(_SWING_M / _FINE_M), endpoint=False)
    soft = 0.5 - 0.5 * np.cos(np.pi * share)
    return np.column_stack(
        [start_m + (end_m - start_m) * share, left_m + (right_m - left_m) * soft]
    )
