"""Mistakes that poles tell: how the motion would be with each, and what it is called."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polemap.drivelog.findings import Finding


@dataclass(frozen=True, slots=True)
class Mistake:
    """A motion as it would be if something were wrong: factors on way and turn; other axes.

    `axes` has the rows of the matrix that brings points as given to x ahead, y left; `oriented`
    are points that do not turn with the car, but lie by the axes of a map, in which the heading of
    the motion begins at this angle; `polar` are ranges and bearings, these in the given unit (rad);
    `loose` are points of which the covariance says nothing; `offset_radps` is added to the yaw
    rate.
    """

    kind: str
    text: str
    way: float = 1.0
    turn: float = 1.0
    axes: tuple[tuple[float, float], tuple[float, float]] | None = None
    oriented: float | None = None
    polar: float | None = None
    offset_radps: float = 0.0
    loose: bool = False


def _turned_by(angle: float) -> tuple[tuple[float, float], tuple[float, float]]:
    c, s = float(np.cos(angle)), float(np.sin(angle))
    return (c, -s), (s, c)


AS_TOLD, LOOSELY = Mistake("", ""), Mistake("", "", loose=True)
MISTAKES = (
    Mistake("pole_turn", "turn to the other side", turn=-1.0),
    Mistake("pole_direction", "move the other way", way=-1.0),
    Mistake("pole_direction", "move the other way and turn to the other side", way=-1.0, turn=-1.0),
    Mistake("pole_axes", "fit with x and y exchanged", axes=((0, 1), (1, 0))),
    Mistake("pole_axes", "fit with x to the right and y ahead", axes=((0, 1), (-1, 0))),
    Mistake("pole_axes", "fit with x to the left and y backward", axes=((0, -1), (1, 0))),
    *(
        Mistake(
            "pole_axes",
            "fit with x and y along fixed directions, such as east and north",
            oriented=float(heading),
            loose=True,
        )
        for heading in np.linspace(0.0, 2.0 * np.pi, 18, endpoint=False)
    ),
    Mistake("pole_polar", "fit with ranges and bearings (rad) for x and y", polar=1.0, loose=True),
    Mistake(
        "pole_polar",
        "fit with ranges and bearings (degrees) for x and y",
        polar=np.pi / 180,
        loose=True,
    ),
    Mistake("pole_speed", "fit a speed 2 times larger (they are twice as far)", way=2.0),
    Mistake("pole_speed", "fit a speed 2 times smaller (they are half as far)", way=0.5),
    Mistake("pole_scale", "fit a speed 1.3 times larger", way=1.3),
    Mistake("pole_scale", "fit a speed 1.3 times smaller", way=1 / 1.3),
    Mistake("pole_speed", "fit a speed 3.6 times smaller (km/h)", way=1 / 3.6),
    Mistake("pole_speed", "fit a speed 3.6 times larger", way=3.6),
    Mistake("pole_speed", "fit a speed 2.24 times smaller (mph)", way=0.44704),
    Mistake("pole_speed", "fit a speed 2.24 times larger", way=1 / 0.44704),
    Mistake("pole_speed", "fit a speed 1.61 times smaller", way=0.621371),
    Mistake("pole_speed", "fit a speed 1.61 times larger", way=1.609344),
    Mistake("pole_speed", "fit a speed 100 times smaller (cm/s)", way=0.01),
    Mistake("pole_speed", "fit a speed 1000 times smaller (mm/s)", way=0.001),
    Mistake("pole_speed", "fit a speed 3.28 times larger (poles in feet)", way=1 / 0.3048),
    Mistake("pole_speed", "fit a speed 3.28 times smaller (ft/s)", way=0.3048),
    Mistake("pole_turn_unit", "fit a yaw rate in degrees", turn=np.pi / 180.0),
    Mistake("pole_turn_unit", "fit a yaw rate 57.3 times larger", turn=180.0 / np.pi),
    *(
        Mistake("pole_turn_offset", "fit a yaw rate with an offset", offset_radps=sign * rate)
        for rate in (0.025, 0.05, 0.1, 0.2)
        for sign in (-1.0, 1.0)
    ),
    *(
        Mistake("pole_mounting", "fit turned axes", axes=_turned_by(sign * np.radians(degrees)))
        for degrees in (4.0, 8.0, 15.0, 25.0)
        for sign in (-1.0, 1.0)
    ),
    *(
        Mistake("pole_turn_scale", f"fit a yaw rate {factor:g} times as large", turn=factor)
        for factor in (0.5, 2.0, 3.0, 4.0, 5.0, 6.5, 8.0, 10.0)
    ),
)


def mistaken(
    mistake: Mistake, poles: str, name: str, ratio: float, pairs: int, confirmed: bool
) -> Finding:
    """The finding that a mistake is, in so many pairs of scans.

    Args:
        poles, name: of the streams.
        ratio: so many times as many poles meet.
        confirmed: another stream agrees with the motion, so that the poles are at fault.
    """
    at_fault = poles if confirmed else name
    remedies = {
        "pole_turn": "write y to the left" if confirmed
        else f"change the sign of the yaw rate of {name}, or of y of {poles}",
        "pole_direction": "write x ahead and y to the left" if confirmed
        else f"change the sign of the speed of {name}, or of x and y of {poles}",
        "pole_axes": "write x ahead and y to the left",
        "pole_scale": "check the distances of the poles" if confirmed
        else f"check the speed of {name} and the distances of {poles}",
        "pole_speed": "check the unit of x and y" if confirmed
        else f"check the unit of the speed of {name} and of x, y of {poles}",
        "pole_polar": "write x = range cos(bearing) and y = range sin(bearing)",
        "pole_turn_unit": "check x and y" if confirmed
        else f"write the yaw rate of {name} in rad/s",
        "pole_mounting": "correct the detector's mounting",
        "pole_turn_scale": "check x and y" if confirmed
        else f"check the unit and scale of the yaw rate of {name} (rad/s, not a curvature)",
    }  # fmt: skip
    return Finding(
        mistake.kind,
        "error",
        poles if mistake.kind in ("pole_axes", "pole_polar") else at_fault,
        f"the poles {mistake.text} against the motion of {name} ({ratio:.2g} times as many meet in "
        f"{pairs} pairs of scans)",
        "poles that stand still",
        remedies[mistake.kind],
    )
