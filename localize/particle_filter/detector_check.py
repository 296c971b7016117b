"""Does the way the car goes contradict the detector's calibration? Its turn, ranges and stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.localize.config import ANY_SLIP_RAD_PER_MPS2, PolesConfig
from polemap.localize.particle_filter.detector_course import DetectorCourse
from polemap.localize.particle_filter.detector_fit import (
    TOLERANCE,
    Change,
    Look,
    Stretch,
    StretchFit,
)
from polemap.localize.particle_filter.landmarks import Landmarks
from polemap.localize.particle_filter.pole_weigher import independent_share
from polemap.vehicle.pose import transform_points

Floats = NDArray[np.float64]

KINDS = ("turned", "ranges", "stamps")
"""What may be wrong, as the columns of `StretchFit.values`."""
# the last so many metres are looked at, each for itself: short ones soon, long ones closely; there
# are more of the short ones, so more standard deviations are asked of them
_STRETCHES_M = {10.0: 3.5, 20.0: 3.0, 40.0: 2.5, 60.0: 2.5, 80.0: 2.5}
_LONGEST_S = 60.0
# scans closer together add little; fits are made so often
_APART_M, _INTERVAL_M = 0.8, 3.0
_LEAST_LOOKS = 8
# of a scan the nearest poles: their ranges are the best, and the fit's time grows with their square
_MOST_POLES = 8
# a pose that is wrong by this much still finds its poles
_MATCH_M = 2.0
# besides what the fit states, sd of what no column explains: side-slip that comes and goes makes
# 0.3 degrees on Victoria Park
_UNEXPLAINED = np.array([0.0052, 0.01, 0.02])
_SETTLED_SD, _SETTLED_M = 1.0, 20.0
# a change at one place is asked for more, since there are many places; what is less sure widens the
# pose, from the first of these excesses on and at the second in full
_CHANGE_SD, _HINT_SD = 3.5, (1.0, 2.5)
# a hint that is gone is forgotten by this factor at every fit
_HINT_KEPT = 0.7
# of poles, before some have been matched
_REACH_M = 15.0
# a turn that many poles have told is still known where few are seen: a mounting that gives way
# wanders by so much in the root of a metre (half of what is tolerated in 75 m), and what is seen
# later speaks for another turn from so many deviations on
_WANDER_RAD_PER_SQRT_M, _ANOTHER_SD = 0.0005, 1.0
# sd of the errors that are met, for what is likely of one that is found
_MET_SD = np.array([2.0, 2.0, 1.0]) * TOLERANCE
# after a contradiction the calibration is acquitted when all looks since then say four times in a
# row that it lies within these by two standard deviations, or when nothing has spoken against it
# on so long a way (where the car goes straight on at one speed, stamps show nowhere)
_ACQUITTED, _ACQUITTED_SD, _LAPSE_M = np.array([0.028, 0.05, 0.2]), 2.0, 120.0
_ACQUITTED_FITS = 4
# after a start a single fit of the ranges is enough; a car that stands, or sees next to nothing, is
# not waited for longer
_START_ACQUITTED, _START_S = np.array([np.inf, 0.1, np.inf]), 2.0


@dataclass(frozen=True, slots=True)
class _KnownTurn:
    """Turn of the detector, its deviation, and the way driven when poles told it."""

    turn_rad: float
    sd_rad: float
    at_m: float

    def sd_at(self, travelled_m: float) -> float:
        """What is left of it further on."""
        way_m = max(travelled_m - self.at_m, 0.0)
        return float(np.hypot(self.sd_rad, _WANDER_RAD_PER_SQRT_M * np.sqrt(way_m)))

    def agrees(self, fit: StretchFit, travelled_m: float) -> bool:
        """Whether what was seen since then does not speak for another one."""
        spread = float(np.hypot(self.sd_at(travelled_m), fit.sd[0]))
        return bool(abs(fit.values[0] - self.turn_rad) <= _ANOTHER_SD * spread)


class DetectorCheck:
    """Follows the matched poles of the last 80 m.

    A contradiction is a turn, scale or stamp error that exceeds what is tolerated by more than 2.5
    standard deviations (3 and 3.5 in the short ones) in any of five stretches. It is over when the
    longest stretch excludes what was found, and finds nothing itself, for 20 m. Of a detector that
    is as wrong as is tolerated a stretch says so once in 160 times, of one that is right hardly
    ever. A change within the last 80 m must exceed it by 3.5.

    When poles contradict the odometry or the place, either side may be wrong. Then the looks from
    there on must speak for the calibration before the pose is trusted again (`suspect`). Of a start
    only the ranges are asked, which a handful of poles show.

    Attributes:
        fit: of the longest stretch at the last look; None before the first.
        course: of the car, as the detector's camera sees it.
    """

    def __init__(
        self, config: PolesConfig, slip_rad_per_mps2: float = ANY_SLIP_RAD_PER_MPS2
    ) -> None:
        self._config = config
        self.course = DetectorCourse(slip_rad_per_mps2)
        self._looks: list[Look] = []
        self._fitted_m = -np.inf
        # which of `KINDS` is wrong, by how much, and since where that is refuted
        self._kind, self._found, self._sound_since_m = -1, 0.0, np.inf
        self._unproven = np.array([False, True, False])
        self._bounds, self._fits_needed = _START_ACQUITTED, 1
        self._started_s = np.inf
        self._unproven_since_m: float | None = None
        self._proven = np.zeros(len(KINDS), dtype=np.int64)
        self._hint = np.zeros(len(KINDS))
        self._speed_mps, self._reach_m = 0.0, _REACH_M
        self.fit: StretchFit | None = None
        self._known_turn: _KnownTurn | None = None

    @property
    def acquitted(self) -> bool:
        """Whether no contradiction is left that the detector may be to blame for."""
        return not self._unproven.any()

    @property
    def hinted_sd(self) -> tuple[float, float]:
        """What the pose may be off by, m and rad, for an error that is likely but not proven."""
        return self._moved_by(np.abs(self._hint))

    @property
    def calibration_sd(self) -> tuple[float, float]:
        """`hinted_sd`, and by how much the turn may exceed what is tolerated.

        A turned detector shows on some way only, and one that turns slowly late; until then it
        moves the pose aside by as much of the poles' distance. Its camera's own course, where there
        is one, shows it within metres. Ranges are asked for at the start, stamps move it along a
        little.
        """
        excess = _MET_SD[0]
        if self.fit is not None:
            excess = abs(self.fit.values[0]) + self.fit.sd[0] - TOLERANCE[0]
            known = self._known_turn
            if known is not None and known.agrees(self.fit, self._fitted_m):
                sd = known.sd_at(self._fitted_m)
                excess = min(excess, abs(known.turn_rad) + sd - TOLERANCE[0])
        elif (told := self.course.turn(-np.inf)) is not None:
            excess = abs(told[0]) + told[1] - TOLERANCE[0]
        possible = np.array([np.clip(excess, 0.0, _MET_SD[0]), 0.0, 0.0])
        return self._moved_by(np.hypot(self._hint, possible))

    def _moved_by(self, errors: Floats) -> tuple[float, float]:
        turn, scale, seconds = errors
        sd_m = np.hypot(self._reach_m * np.hypot(turn, scale), seconds * self._speed_mps)
        return float(sd_m), float(turn)

    @property
    def contradicts(self) -> str:
        """The name of what is wrong, "" while nothing is."""
        return KINDS[self._kind] if self._kind >= 0 else ""

    def forget(self) -> None:
        """The path was broken: a new place, or an odometry in doubt. What was found stands."""
        self._looks.clear()
        self._fitted_m = -np.inf
        self._hint = np.zeros(len(KINDS))

    def suspect(self) -> None:
        """Poles contradict the place or the odometry: what was seen before proves nothing now."""
        self.forget()
        self._doubt()

    def absolve(self) -> None:
        """The place was right: what contradicted it was not the detector."""
        self._unproven[:] = False

    def _doubt(self) -> None:
        self._known_turn = None
        self._unproven[:] = True
        self._bounds, self._fits_needed = _ACQUITTED, _ACQUITTED_FITS
        self._proven[:] = 0
        self._unproven_since_m = None

    def add_scan(
        self,
        scan: Detections,
        landmarks: Landmarks,
        pose: Floats,
        odometry_pose: Floats,
        travelled_m: float,
        rates: tuple[float, float],
        *,
        proven: bool = True,
    ) -> bool:
        """Take in a scan; whether a contradiction has begun with it.

        Args:
            scan: as it was seen.
            landmarks: of the map, around the car.
            pose: `(3,)` of the rear axle in the map, by which poles are matched.
            odometry_pose: `(3,)` dead reckoned.
            travelled_m: way until then.
            rates: speed and yaw rate.
            proven: whether the place is; before it is, looks are kept and nothing is judged.
        """
        looks = self._looks
        if proven and self._bounds is _START_ACQUITTED:
            self._started_s = min(self._started_s, scan.stamp_s)
            if scan.stamp_s - self._started_s > _START_S:
                self._unproven[:] = False
        moved_m = travelled_m - looks[-1].travelled_m if looks else _APART_M
        if moved_m < _APART_M:
            return False
        elapsed_s = scan.stamp_s - looks[-1].stamp_s if looks else 0.0
        share = independent_share(moved_m, elapsed_s, self._config)
        looks.append(_matched(scan, landmarks, pose, odometry_pose, travelled_m, rates, share))
        while (
            looks[0].travelled_m < travelled_m - max(_STRETCHES_M)
            or looks[0].stamp_s < scan.stamp_s - _LONGEST_S
        ):
            looks.pop(0)
        if not proven or travelled_m - self._fitted_m < _INTERVAL_M:
            return False
        if not len(looks[-1].map_points_m):
            # nothing new, and a path that is laid by a pose that nothing holds
            return False
        self._fitted_m = travelled_m
        self._speed_mps = abs(rates[0])
        # the poles that hold the pose are so far away: a turn moves it aside by as much of it
        near = [look.points_vehicle_m for look in looks[-_LEAST_LOOKS:]]
        self._reach_m = float(np.sqrt(np.mean(np.sum(np.concatenate(near) ** 2, axis=1))))
        return self._judge(pose, travelled_m)

    def _judge(self, pose: Floats, travelled_m: float) -> bool:
        looks = self._looks
        ways = np.repeat(
            [look.travelled_m for look in looks], [len(look.map_points_m) for look in looks]
        )
        if np.count_nonzero(ways >= travelled_m - max(_STRETCHES_M)) < _LEAST_LOOKS:
            self._sound_since_m = np.inf
            return False
        stretch = Stretch(looks, pose)
        self._hint = np.where(self._hint > 0.1 * TOLERANCE, _HINT_KEPT * self._hint, 0.0)
        change = stretch.change()
        if change is not None:
            at_m = looks[change.look].travelled_m
            change = change.with_turn(
                self.course.turn(looks[0].travelled_m, at_m), self.course.turn(at_m)
            )
        if change is not None and self._changed(change):
            # what was seen before the change is of another detector
            del looks[: change.look]
            return self._accuse(change.kind, change.value)
        worst, kind, found = 0.0, -1, 0.0
        sound, proven = True, np.zeros(len(KINDS), dtype=np.bool_)
        for length_m, limit_sd in _STRETCHES_M.items():
            since_m = travelled_m - length_m
            if np.count_nonzero(ways >= since_m) < _LEAST_LOOKS:
                continue
            told = self.course.turn(max(since_m, looks[0].travelled_m))
            fit = self.fit = stretch.fit(since_m).with_turn(told)
            sd = np.hypot(fit.sd, _UNEXPLAINED)
            excess = (np.abs(fit.values) - TOLERANCE) / sd
            if excess.max() - limit_sd > worst:
                worst, kind = float(excess.max()) - limit_sd, int(excess.argmax())
                found = float(fit.values[kind])
            self._note_hint(fit.values, sd, excess)
            proven = np.abs(fit.values) + _ACQUITTED_SD * sd <= self._bounds
            sound = bool(excess.max() < _SETTLED_SD) and (
                self._kind < 0
                or abs(fit.values[self._kind] - self._found) > limit_sd * sd[self._kind]
            )
        if kind >= 0:
            return self._accuse(kind, found)
        self._remember_turn(travelled_m)
        self._acquit(proven, travelled_m)
        if not sound:
            self._sound_since_m = np.inf
        else:
            self._sound_since_m = min(self._sound_since_m, travelled_m)
            if travelled_m - self._sound_since_m >= _SETTLED_M:
                self._kind = -1
        return False

    def _remember_turn(self, travelled_m: float) -> None:
        """Keep the turn where poles have told it best."""
        if self.fit is None:
            return
        known, (turn, *_), (sd, *_) = self._known_turn, self.fit.values, self.fit.sd
        if (
            known is None
            or sd <= known.sd_at(travelled_m)
            or not known.agrees(self.fit, travelled_m)
        ):
            self._known_turn = _KnownTurn(float(turn), float(sd), travelled_m)

    def _changed(self, change: Change) -> bool:
        sd = np.hypot(change.sd, _UNEXPLAINED[change.kind])
        excess = (abs(change.value) - TOLERANCE[change.kind]) / sd
        values = np.zeros(len(KINDS))
        values[change.kind] = change.value
        self._note_hint(values, sd, excess)
        return bool(excess > _CHANGE_SD)

    def _note_hint(self, values: Floats, sd: Floats, excess: Floats) -> None:
        low, high = _HINT_SD
        likely = _MET_SD**2 / (_MET_SD**2 + sd**2) * np.abs(values)
        hint = np.clip((excess - low) / (high - low), 0.0, 1.0) * likely
        self._hint = np.maximum(self._hint, hint)

    def _accuse(self, kind: int, found: float) -> bool:
        begins, self._kind, self._found = self._kind < 0, kind, found
        self._sound_since_m = np.inf
        # it is over when what was found is refuted; what else it may have been must be, too
        self._doubt()
        return begins

    def _acquit(self, proven: NDArray[np.bool_], travelled_m: float) -> None:
        if self._unproven_since_m is None or self._hint.any():
            self._unproven_since_m = travelled_m
        self._proven = np.where(proven, self._proven + 1, 0)
        self._unproven &= self._proven < self._fits_needed
        if travelled_m - self._unproven_since_m > _LAPSE_M:
            self._unproven[:] = False


def _matched(
    scan: Detections,
    landmarks: Landmarks,
    pose: Floats,
    odometry_pose: Floats,
    travelled_m: float,
    rates: tuple[float, float],
    share: float,
) -> Look:
    """Poles and map poles that are nearest to each other, within `_MATCH_M`."""
    seen = transform_points(pose, scan.points_vehicle_m.reshape(-1, 2))
    distance = np.hypot(*(seen[:, None] - landmarks.points_m).transpose(2, 0, 1))
    distance[scan.kind[:, None] != landmarks.kind] = np.inf
    pairs: list[tuple[int, int]] = []
    if distance.size:
        nearest = distance.argmin(axis=1)
        back = distance.argmin(axis=0)
        pairs = [
            (i, j)
            for i, j in enumerate(nearest.tolist())
            if back[j] == i and distance[i, j] < _MATCH_M
        ]
    rows = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    far = np.hypot(*scan.points_vehicle_m.reshape(-1, 2)[rows[:, 0]].T)
    mine, theirs = rows[np.sort(np.argsort(far, kind="stable")[:_MOST_POLES])].T
    return Look(
        stamp_s=scan.stamp_s,
        travelled_m=travelled_m,
        odometry_pose=odometry_pose.copy(),
        speed_mps=rates[0],
        yaw_rate_radps=rates[1],
        points_vehicle_m=scan.points_vehicle_m.reshape(-1, 2)[mine],
        covariance_m2=scan.covariance_m2.reshape(-1, 2, 2)[mine],
        map_points_m=landmarks.points_m[theirs],
        map_var_m2=landmarks.covariance_m2[theirs, :2].mean(axis=1),
        share=share,
    )
