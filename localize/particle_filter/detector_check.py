"""Does the way the car goes contradict the detector's calibration? Its turn, ranges and stamps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.localize.config import PolesConfig
from polemap.localize.particle_filter.detector_fit import Look, Stretch, StretchFit
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
# a calibration is as good as this in use: 0.5 degrees, 2 %, 0.1 s (of a recording that is held
# good, Victoria Park, the laser's stamps are 0.07 s off)
_TOLERANCE = np.array([0.0087, 0.02, 0.1])
# besides what the fit states, sd of what no column explains: side-slip that comes and goes makes
# 0.3 degrees on Victoria Park
_UNEXPLAINED = np.array([0.0052, 0.01, 0.02])
_SETTLED_SD, _SETTLED_M = 1.0, 20.0


class DetectorCheck:
    """Follows the matched poles of the last 80 m.

    A contradiction is a turn, scale or stamp error that exceeds what is tolerated by more than 2.5
    standard deviations (3 and 3.5 in the short ones) in any of five stretches. It is over when the
    longest stretch excludes what was found, and finds nothing itself, for 20 m. Of a detector that
    is as wrong as is tolerated a stretch says so once in 160 times, of one that is right hardly
    ever.

    Attributes:
        fit: of the longest stretch at the last look; None before the first.
    """

    def __init__(self, config: PolesConfig) -> None:
        self._config = config
        self._looks: list[Look] = []
        self._fitted_m = -np.inf
        # which of `KINDS` is wrong, by how much, and since where that is refuted
        self._kind, self._found, self._sound_since_m = -1, 0.0, np.inf
        self.fit: StretchFit | None = None

    @property
    def contradicts(self) -> str:
        """The name of what is wrong, "" while nothing is."""
        return KINDS[self._kind] if self._kind >= 0 else ""

    def forget(self) -> None:
        """The path was broken: a new place, or an odometry in doubt. What was found stands."""
        self._looks.clear()
        self._fitted_m = -np.inf

    def add_scan(
        self,
        scan: Detections,
        landmarks: Landmarks,
        pose: Floats,
        odometry_pose: Floats,
        travelled_m: float,
        rates: tuple[float, float],
    ) -> bool:
        """Take in a scan; whether a contradiction has begun with it.

        Args:
            scan: as it was seen.
            landmarks: of the map, around the car.
            pose: `(3,)` of the rear axle in the map, by which poles are matched.
            odometry_pose: `(3,)` dead reckoned.
            travelled_m: way until then.
            rates: speed and yaw rate.
        """
        looks = self._looks
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
        if travelled_m - self._fitted_m < _INTERVAL_M:
            return False
        self._fitted_m = travelled_m
        return self._judge(pose, travelled_m)

    def _judge(self, pose: Floats, travelled_m: float) -> bool:
        looks = self._looks
        ways = np.repeat(
            [look.travelled_m for look in looks], [len(look.map_points_m) for look in looks]
        )
        worst, kind, stretch = 0.0, -1, None
        sound = True
        for length_m, limit_sd in _STRETCHES_M.items():
            since_m = travelled_m - length_m
            if np.count_nonzero(ways >= since_m) < _LEAST_LOOKS:
                continue
            stretch = stretch or Stretch(looks, pose)
            fit = self.fit = stretch.fit(since_m)
            sd = np.hypot(fit.sd, _UNEXPLAINED)
            excess = (np.abs(fit.values) - _TOLERANCE) / sd
            if excess.max() - limit_sd > worst:
                worst, kind = float(excess.max()) - limit_sd, int(excess.argmax())
                found = float(fit.values[kind])
            sound = bool(excess.max() < _SETTLED_SD) and (
                self._kind < 0
                or abs(fit.values[self._kind] - self._found) > limit_sd * sd[self._kind]
            )
        if kind >= 0:
            begins, self._kind, self._found = self._kind < 0, kind, found
            self._sound_since_m = np.inf
            return begins
        if stretch is None or not sound:
            self._sound_since_m = np.inf
        else:
            self._sound_since_m = min(self._sound_since_m, travelled_m)
            if travelled_m - self._sound_since_m >= _SETTLED_M:
                self._kind = -1
        return False


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
