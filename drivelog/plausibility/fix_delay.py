"""How late the fixes tell where the car was: they lie behind it by the delay times the speed.

The shared error of fixes wanders over a minute, a delay turns with the car. Over stretches of some
ten seconds the fixes are held against the way that the reference, or else the odometry, tells:

    fix(t) - p(t) = b + L h(t) - delay v(t) + noise

with b constant in a stretch, h the heading, v the velocity, and L an antenna farther ahead than
stated, which only changes of speed tell from a delay. A way of the odometry has unknowns of its own
in every stretch: heading, scale of the speed, offset of the yaw rate. `antenna` takes the same
equations with the antenna's place as what is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.findings import Finding
from polemap.drivelog.plausibility.odometer import Odometer
from polemap.vehicle.pose import rotate

Floats = NDArray[np.float64]

_STRETCH_S = 24.0
# errors of fixes are as good as one over this time, however many fixes it holds
_INDEPENDENT_S = 3.0
_LEVER_SD_M = 1.5
_DELAY_DOUBT_S, _DELAY_WRONG_S, _DELAY_SDS, _DELAY_SD_MAX_S = 0.35, 3.0, 5.0, 0.2
_FIXES_MIN, _STRETCHES_MIN = 8, 2


@dataclass(frozen=True, slots=True)
class Delay:
    """By how much the fixes are late, and the standard deviation of that."""

    delay_s: float
    sd_s: float


def delay_findings(drive: Drive, motion: Odometer, *, heading_known: bool) -> list[Finding]:
    """Fixes that are late or early by less than the correlation of speeds and turns shows."""
    delay = find_delay(drive, motion, heading_known=heading_known)
    if delay is None or delay.sd_s > _DELAY_SD_MAX_S:
        return []
    size, late = abs(delay.delay_s), delay.delay_s > 0.0
    if size < _DELAY_DOUBT_S or size < _DELAY_SDS * delay.sd_s:
        return []
    return [
        Finding(
            "clock_offset", "error" if size > _DELAY_WRONG_S else "warning", drive.names.gnss,
            f"the fixes lie where {motion.name} was {size:.2f} s {'before' if late else 'later'} "
            f"(sd {delay.sd_s:.2f} s)", f"within {_DELAY_DOUBT_S:g} s",
            f"{'subtract' if late else 'add'} {size:.2f} s {'from' if late else 'to'} its stamps",
        )
    ]  # fmt: skip


def find_delay(drive: Drive, motion: Odometer, *, heading_known: bool) -> Delay | None:
    """The delay of the fixes behind a motion; None where they are too few.

    Args:
        heading_known: the headings of the motion are of the drive's frame (a reference).
    """
    rows = find_equations(drive, motion, heading_known=heading_known)
    if rows is None or rows.stretches < _STRETCHES_MIN:
        return None
    return _solve(rows.design[:, :2], rows.target_m, rows.weight)


@dataclass(frozen=True, slots=True)
class Equations:
    """Rows of all stretches with the stretches' own unknowns taken out.

    Attributes:
        design: `(n, 3)` columns of the delay (s) and of the antenna's place ahead and left (m).
        target_m, weight: `(n,)`.
        stretches: how many there are.
    """

    design: Floats
    target_m: Floats
    weight: Floats
    stretches: int


def find_equations(drive: Drive, motion: Odometer, *, heading_known: bool) -> Equations | None:
    """What the fixes say of delay and antenna, held against a motion; None where they are too few.

    Args:
        heading_known: the headings of the motion are of the drive's frame (a reference).
    """
    gnss = drive.gnss
    if gnss is None or len(gnss) < _FIXES_MIN or len(motion) < _FIXES_MIN:
        return None
    stamps = gnss.stamp_s
    places, heading, speed, known = find_way(motion, stamps)
    fixes = np.stack([gnss.east_m, gnss.north_m], axis=1)
    known &= np.isfinite(fixes).all(axis=1)
    number = np.floor((stamps - stamps[0]) / _STRETCH_S)
    blocks = []
    for stretch in np.unique(number[known]):
        rows = np.flatnonzero(known & (number == stretch))
        if len(rows) < _FIXES_MIN or stamps[rows[-1]] - stamps[rows[0]] < 0.5 * _STRETCH_S:
            continue
        block = _stretch(
            fixes[rows], places[rows], heading[rows], speed[rows], stamps[rows],
            drive.gnss_antenna_m, heading_known,
        )  # fmt: skip
        if block is not None:
            blocks.append(block)
    if not blocks:
        return None
    design, target, weight = (np.concatenate(part) for part in zip(*blocks, strict=True))
    return Equations(design, target, weight, len(blocks))


def find_way(motion: Odometer, stamps: Floats) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    """Places `(n, 2)` by summing up the motion, headings, speeds, and where they are known."""
    step = np.diff(motion.path_m)
    middle = 0.5 * (motion.heading_rad[1:] + motion.heading_rad[:-1])
    steps = np.stack([step * np.cos(middle), step * np.sin(middle)], axis=1)
    summed = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    places = np.stack([np.interp(stamps, motion.stamp_s, summed[:, k]) for k in (0, 1)], axis=1)
    heading = np.interp(stamps, motion.stamp_s, motion.heading_rad)
    way, _, known = motion.spans(stamps - 0.5, stamps + 0.5)
    return places, heading, way, known


def _stretch(
    fixes: Floats, places: Floats, heading: Floats, speed: Floats, stamps: Floats,
    antenna_m: Floats, heading_known: bool,
) -> tuple[Floats, Floats, Floats] | None:  # fmt: skip
    """Rows of the delay's and the lever's equations with the stretch's own unknowns taken out."""
    if np.ptp(places, axis=0).max() < 20.0:
        return None
    a, b = places - places.mean(axis=0), fixes - fixes.mean(axis=0)
    if not heading_known:
        turn = float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))
        a, heading = rotate(a, turn), heading + turn
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    off = b - a - rotate(np.broadcast_to(antenna_m, a.shape), heading)
    own = [np.tile([1.0, 0.0], (len(a), 1)), np.tile([0.0, 1.0], (len(a), 1))]
    if not heading_known:
        own += way_unknowns(a, stamps)
    shared = np.stack([-speed[:, None] * ahead, ahead, left], axis=2).reshape(-1, 3)
    basis, _ = np.linalg.qr(np.stack([column.ravel() for column in own], axis=1))
    shared = shared - basis @ (basis.T @ shared)
    target = off.ravel() - basis @ (basis.T @ off.ravel())
    density = min(float(np.median(np.diff(stamps))) / _INDEPENDENT_S, 1.0)
    return shared, target, np.full(len(target), density)


def way_unknowns(places_m: Floats, stamps_s: Floats) -> list[Floats]:
    """By how much places `(n, 2)` of a summed up way move with its heading, the scale of its speed
    and the offset of its yaw rate: columns `(n, 2)`."""
    elapsed = stamps_s - stamps_s.mean()
    steps = np.diff(places_m, axis=0) * (0.5 * (elapsed[1:] + elapsed[:-1]))[:, None]
    bent = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    turned = [np.stack([-way[:, 1], way[:, 0]], axis=1) for way in (places_m, bent)]
    return [turned[0], places_m, turned[1]]


def _solve(design: Floats, target: Floats, density: Floats) -> Delay:
    """Robust least squares of the delay, with the antenna known to a metre or two."""
    prior = np.diag([1e-9, 1.0 / _LEVER_SD_M**2])
    fit: Floats = np.zeros(2)
    total: Floats = prior
    for _ in range(15):
        rest: Floats = target - design @ fit
        scale = 1.4826 * float(np.median(np.abs(rest))) + 1e-3
        weight = density / (1.0 + (rest / (2.0 * scale)) ** 2) / scale**2
        total = np.asarray((design * weight[:, None]).T @ design + prior)
        fit = np.asarray(np.linalg.solve(total, design.T @ (weight * target)), dtype=np.float64)
    return Delay(float(fit[0]), float(np.sqrt(np.linalg.inv(total)[0, 0])))
