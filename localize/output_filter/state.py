"""What the output filter knows at one moment, and what it is told."""

from __future__ import annotations

from typing import NamedTuple

from polemap.vehicle.packed import Mean, Pose, Upper

# upper triangle of a pose's 3x3 covariance, row by row
PoseUpper = tuple[float, float, float, float, float, float]


class OdometryEvent(NamedTuple):
    """Speed and yaw rate; which of the two contradicts what came before it, the poles or the fixes,
    or what a car can do."""

    speed_mps: float
    yaw_rate_radps: float
    doubted: bool = False
    turn_doubted: bool = False


class PoseEvent(NamedTuple):
    """A pose of the particle filter that was offered, with its covariance `(3, 3)` packed, what it
    holds the slip of the rear axle for, and whether its scan found poles of the map."""

    pose: Pose
    upper: PoseUpper
    slip_rad_per_mps2: float = 0.0
    held: bool = True


class GnssEvent(NamedTuple):
    """An antenna position and its standard deviation."""

    east_m: float
    north_m: float
    sd_m: float


class RestartEvent(NamedTuple):
    """A pose that the last fixes agree on, while the filter disagrees with them for long."""

    pose: Pose
    upper: PoseUpper


NEVER = float("-inf")
"""Stamp of what has not happened."""

Event = OdometryEvent | PoseEvent | GnssEvent | RestartEvent


class Counts(NamedTuple):
    """Decisions so far; part of the state, so that a replay corrects them too."""

    poses_accepted: int = 0
    gate_rejections: int = 0
    inflations: int = 0
    incoherent: int = 0
    reinitializations: int = 0
    takeovers: int = 0
    gnss_vetoes: int = 0
    odometry_rejections: int = 0
    odometry_doubted: int = 0
    gnss_accepted: int = 0
    gnss_rejections: int = 0
    gnss_restarts: int = 0
    gnss_renewals: int = 0


class Rival(NamedTuple):
    """What the rejected poses say, kept as the first of them and where the filter was then.

    If both are led on by the same odometry, the rival is the first rejected pose moved as the
    filter has moved since. `evidence` is the sum over `fixes` GNSS fixes of how much better
    (log-likelihood) the filter explains the fix than the rival does. `first_s` is the stamp of the
    first pose rejected since one was accepted, and `rejected` counts them, also where those between
    did not agree among themselves.
    """

    since_s: float
    pose: Pose
    filter_pose: Pose
    first_s: float
    rejected: int = 0
    fixes: int = 0
    evidence: float = 0.0


class FilterState(NamedTuple):
    """Immutable, so that replay can go back to it.

    Attributes:
        mean: east, north, yaw, speed, yaw rate of the rear axle; relative error of the odometry's
            speed, offset of its yaw rate; error that fixes share, east and north.
        upper: upper triangle of the covariance.
        odometry_rejected: samples in a row.
        gnss_rejected: fixes in a row that have failed.
        gnss_rejected_since_s: since when all fixes have failed, infinite if they do not.
        decision: what became of the last pose.
        nis: its squared Mahalanobis distance.
        slip_rad_per_mps2: outward slip of the rear axle per lateral acceleration.
        held_s: stamp of the last accepted pose whose scan found poles of the map.
        odometry_s: stamp of the last odometry, in doubt or not.
        doubted: whether that was in doubt.
        still_since_s: since when all odometry says that the car stands, infinite if it does not.
        odometry_prior: variances of the odometry's errors before anything is learned of them.
        gnss_wrong: whether fixes have failed while poles held the pose.
        gnss_passed: fixes in a row that have passed since.
    """

    stamp_s: float
    mean: Mean
    upper: Upper
    counts: Counts = Counts()
    rival: Rival | None = None
    last_pose_s: float = NEVER
    last_gnss_s: float = NEVER
    odometry_rejected: int = 0
    gnss_rejected_since_s: float = float("inf")
    gnss_rejected: int = 0
    decision: str = ""
    nis: float = float("nan")
    slip_rad_per_mps2: float = 0.0
    held_s: float = NEVER
    odometry_s: float = NEVER
    doubted: bool = False
    still_since_s: float = float("inf")
    odometry_prior: tuple[float, float] = (0.0, 0.0)
    gnss_wrong: bool = False
    gnss_passed: int = 0
