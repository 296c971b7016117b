"""What errors that last leave unknown of the pose: those of the poles and of the odometry."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.detections import Detections
from polemap.extras import kernel
from polemap.localize.particle_filter.landmarks import Landmarks
from polemap.vehicle.kalman import symmetric
from polemap.vehicle.pose import mean_way, reference_point_jacobian, rotate_covariance

Floats = NDArray[np.float64]

KERNEL = "polemap.localize.particle_filter.native.particle_kernel"

# share of the variance of a seen position that stays with the pole while it is passed: a stem's
# disparity errs alike in all looks (docs/maps.md, step 5)
_SHARE = 0.5
# poles whose errors are kept, the last that were seen
_MOST = 16
# no pole is seen better than this, even where detector, map and settings say so
_LEAST_FLOOR_M = 1e-4


@dataclass(slots=True)
class PersistentErrors:
    """Covariance of the particles' mean under errors that last, which the particles leave out.

    The particles take every few metres, or seconds, of a pole for new evidence, and the odometry's
    errors for white noise. That is right in the mean and wrong where it matters: beside two or
    three far poles at a start, and on a way without poles while the scale of the speed is not known
    yet. Here the gain that the particles use is put into the covariance of an estimator that is not
    optimal, with these errors that last: the place of every pole in the map, a share of how
    it is seen, the scale of the speed and the offset of the yaw rate as far as they are not
    learned.

    Attributes:
        covariance: `(3, 3)` of the pose's error: east, north, yaw.
        floor_m: standard deviation of every seen position besides what its detector states.
        lines, line_ids: `(3, m)` of the pose's error with errors of lines, see `line_errors.py`.

    Source: Gelb (1974), "Applied Optimal Estimation", section 7.2; Schmidt's consider states.
    """

    floor_m: float
    covariance: Floats = field(default_factory=lambda: np.eye(3))
    # covariances of the pose's error with the errors that last, each of variance one: speed and yaw
    # rate `(3, 2)`, poles `(3, 2 n)`
    _odometry: Floats = field(default_factory=lambda: np.zeros((3, 2)))
    _poles: Floats = field(default_factory=lambda: np.zeros((3, 0)))
    _ids: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    lines: Floats = field(default_factory=lambda: np.zeros((3, 0)))
    line_ids: list[int] = field(default_factory=list)

    def start(self, covariance: Floats) -> None:
        """A new place, known by a covariance `(3, 3)`."""
        self.covariance = np.array(covariance, dtype=np.float64)
        self._odometry = np.zeros((3, 2))
        self._poles, self._ids = np.zeros((3, 0)), np.empty(0, dtype=np.int64)
        self.lines, self.line_ids = np.zeros((3, 0)), []

    def move(
        self, before: Floats, after: Floats, elapsed_s: float, sd: tuple[float, float]
    ) -> None:
        """The car has moved.

        Args:
            before, after: rear-axle poses of the particles `(n, 3)`. The noise of their motion
                is in their own covariance, and left out here.
            elapsed_s: on the way.
            sd: of the speed's scale and of the yaw rate, rad/s, as far as they are known.
        """
        moved = mean_way(before, after)
        transition = np.eye(3)
        transition[:2, 2] = -moved[1], moved[0]
        lasting = np.zeros((3, 2))
        lasting[:2, 0] = sd[0] * moved
        lasting[:2, 1] = 0.5 * elapsed_s * sd[1] * transition[:2, 2]
        lasting[2, 1] = elapsed_s * sd[1]
        led = transition @ self._odometry
        self.covariance = symmetric(
            transition @ self.covariance @ transition.T
            + led @ lasting.T + lasting @ led.T + lasting @ lasting.T
        )  # fmt: skip
        self._odometry = led + lasting
        self._poles = transition @ self._poles
        self.lines = transition @ self.lines

    def add_fixes(self, particles: Floats, information_per_m2: float) -> None:
        """Fixes have moved particles of covariance `(3, 3)`, which is that after them."""
        if information_per_m2 <= 0.0:
            return
        gain = particles[:, :2] * information_per_m2
        kept = np.eye(3)
        kept[:, :2] -= gain
        self.keep(kept)
        self.covariance += gain @ gain.T / information_per_m2

    def add_scan(
        self,
        particles: Floats,
        scan: Detections,
        landmarks: Landmarks,
        pose: Floats,
        assignment: NDArray[np.int32],
        share: float,
    ) -> None:
        """Poles have moved particles of covariance `(3, 3)`, which is that before them.

        Args:
            particles: their covariance.
            scan: as it was seen.
            landmarks: of the map, around the car.
            pose: `(3,)` of the rear axle in the map.
            assignment: `(z,)` landmark of every seen pole, -1 for clutter.
            share: power that the scan's likelihood was raised to.
        """
        mine = np.flatnonzero(assignment >= 0)
        if share <= 0.0 or not len(mine):
            return
        theirs = assignment[mine]
        column = self._columns(landmarks.ids[theirs])
        native = kernel(KERNEL)
        step = plain_scan if native is None else native.add_scan
        kept, self.covariance, self._poles = step(
            particles,
            self.covariance,
            self._poles,
            scan.points_vehicle_m.reshape(-1, 2)[mine],
            scan.covariance_m2.reshape(-1, 2, 2)[mine],
            landmarks.covariance_m2[theirs],
            column,
            float(pose[2]),
            max(self.floor_m, _LEAST_FLOOR_M) ** 2,
            share,
            _SHARE,
        )
        self._odometry = kept @ self._odometry
        self.lines = kept @ self.lines

    def keep(self, kept: Floats) -> None:
        """A measurement has left so much `(3, 3)` of the pose's error."""
        self.covariance = kept @ self.covariance @ kept.T
        self._odometry = kept @ self._odometry
        self._poles = kept @ self._poles
        self.lines = kept @ self.lines

    def _columns(self, ids: NDArray[np.int64]) -> NDArray[np.int64]:
        """First columns of the errors of map poles `(k,)`; of the others the last ones stay."""
        wanted, before = set(ids.tolist()), self._ids.tolist()
        unseen = [i for i, pole in enumerate(before) if pole not in wanted]
        again = [i for i, pole in enumerate(before) if pole in wanted]
        stay = unseen[max(0, len(unseen) + len(ids) - _MOST) :] + again
        known = [before[i] for i in stay]
        new = sorted(wanted.difference(known), key=ids.tolist().index)
        kept = self._poles.reshape(3, -1, 2)[:, stay].reshape(3, -1)
        self._poles = np.hstack([kept, np.zeros((3, 2 * len(new)))])
        self._ids = np.array(known + new, dtype=np.int64)
        order = {pole: i for i, pole in enumerate(known + new)}
        return 2 * np.array([order[pole] for pole in ids.tolist()])


def look(
    points_m: Floats, seen_m2: Floats, mapped_m2: Floats, yaw_rad: float, floor_m2: float
) -> tuple[Floats, Floats, Floats]:
    """Landmarks held against the map: covariances `(k, 2, 2)` east and north of what is seen and
    of what is mapped, and the derivative `(k, 2, 3)` of the places by the pose.

    Args:
        points_m, seen_m2: `(k, 2)`, `(k, 2, 2)` in the vehicle frame.
        mapped_m2: `(k, 3)` var east, var north, covariance.
        floor_m2: variance besides `seen_m2`.
    """
    seen = rotate_covariance(seen_m2 + floor_m2 * np.eye(2), yaw_rad)
    mapped = mapped_m2[:, [0, 2, 2, 1]].reshape(-1, 2, 2)
    jacobian = reference_point_jacobian(yaw_rad, points_m[:, 0], points_m[:, 1])[:, :2]
    return seen, mapped, jacobian


def plain_scan(
    particles: Floats,
    covariance: Floats,
    poles: Floats,
    points_m: Floats,
    seen_m2: Floats,
    mapped_m2: Floats,
    column: NDArray[np.int64],
    yaw_rad: float,
    floor_m2: float,
    share: float,
    lasting_share: float,
) -> tuple[Floats, Floats, Floats]:
    """One scan of k matched poles; the kernel computes the same.

    Args:
        particles: their covariance `(3, 3)` before the scan.
        covariance: of the pose's error `(3, 3)`.
        poles: its covariances `(3, m)` with the errors of the poles.
        points_m: `(k, 2)` where they are seen, vehicle frame.
        seen_m2: `(k, 2, 2)` covariances of that, vehicle frame.
        mapped_m2: `(k, 3)` var east, var north, covariance in the map.
        column: `(k,)` first columns of their errors in `poles`.
        floor_m2: variance besides `seen_m2`.
        share: power that the scan's likelihood was raised to.
        lasting_share: of the variance of a seen position, what stays with the pole.

    Returns:
        What is left of the pose's error `(3, 3)`; covariance and poles after the scan.
    """
    count = len(points_m)
    seen, mapped, jacobian = look(points_m, seen_m2, mapped_m2, yaw_rad, floor_m2)
    flat = jacobian.reshape(-1, 3)
    across = particles @ flat.T
    gain = np.linalg.solve(flat @ across + _blocks((seen + mapped) / share), across.T).T
    kept = np.eye(3) - gain @ flat
    lasting = np.zeros((count, 2, poles.shape[1] // 2, 2))
    lasting[np.arange(count), :, column // 2] = np.linalg.cholesky(lasting_share * seen + mapped)
    moved = gain @ lasting.reshape(2 * count, -1)
    led = kept @ poles
    # neighbouring scans share the other part too, which the power of the scan counts for
    white = _blocks((1.0 - lasting_share) / share * seen)
    after = symmetric(
        kept @ covariance @ kept.T + gain @ white @ gain.T
        + moved @ moved.T - led @ moved.T - moved @ led.T
    )  # fmt: skip
    return kept, after, led - moved


def _blocks(matrices: Floats) -> Floats:
    """Matrices `(n, 2, 2)` along the diagonal of one `(2 n, 2 n)`."""
    count = len(matrices)
    out = np.zeros((count, 2, count, 2))
    out[np.arange(count), :, np.arange(count)] = matrices
    return out.reshape(2 * count, 2 * count)


def at_least(covariance: Floats, floor: Floats) -> Floats:
    """The smallest covariance `(3, 3)` that is nowhere below either of two, along the axes that
    both share (those that make the one round and the other a diagonal)."""
    root = np.linalg.cholesky(covariance + 1e-12 * np.eye(len(covariance)))
    inside = np.linalg.solve(root, np.linalg.solve(root, floor).T)
    values, axes = np.linalg.eigh(symmetric(inside))
    if values[-1] <= 1.0:
        return covariance
    grown = root @ axes * np.sqrt(np.maximum(values, 1.0))
    return np.asarray(grown @ grown.T)
