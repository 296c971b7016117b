"""The output filter: odometry and late poses, in time order, to a smooth pose at any moment.

A CTRV extended Kalman filter (S16, III-D) behind a replay buffer: every input is taken in at its
own stamp, and what came before it but is later in time is done again. Every decision (gate,
rejection policy, counts) is part of the state, so a replay decides again, as in time order.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from polemap.localize.clocks import is_time
from polemap.localize.gnss.ekf_update import update_by_gnss
from polemap.localize.gnss.outlier_mixture import GnssReceiver
from polemap.localize.gnss.start import GnssStart
from polemap.localize.output_filter.config import OutputConfig
from polemap.localize.output_filter.failed_gate import (
    reset_odometry,
    reset_pose,
    reset_pose_by_fixes,
)
from polemap.localize.output_filter.gate import gate_limits
from polemap.localize.output_filter.noise_model import NoiseModel
from polemap.localize.output_filter.odometry_update import update_by_odometry
from polemap.localize.output_filter.pose_update import update_by_pose
from polemap.localize.output_filter.state import (
    NEVER,
    Event,
    FilterState,
    GnssEvent,
    OdometryEvent,
    PoseEvent,
    PoseUpper,
    RestartEvent,
)
from polemap.localize.usable import FARTHEST_ON_EARTH_M
from polemap.vehicle.ctrv import ctrv_predict
from polemap.vehicle.delay import Placement, ReplayBuffer
from polemap.vehicle.kalman import (
    is_covariance,
)
from polemap.vehicle.packed import (
    Pose,
    pack,
    wrap,
)

Floats = NDArray[np.float64]

# of rejected fixes, without an accepted pose, before the filter starts anew from the fixes
_GNSS_RESTART_AFTER_S = 5.0
# ... where poles have shown the fixes to be wrong: they may have come right in the meantime
_WRONG_RESTART_AFTER_S = 60.0
_NO_LEVER_ARM, _CAR = GnssReceiver(), NoiseModel()
# order of events of one stamp
_ODOMETRY, _GNSS, _RESTART, _POSE = 0, 1, 2, 3

# a day later the car may be anywhere; a spread that grows on loses its covariance to rounding
_PREDICTED_MAX_S = 86_400.0


class OutputFilter:
    """CTRV EKF with exact out-of-sequence replay.

    Args:
        config: settings.
        receiver: where the GNSS antenna is, and how well it measures.
        slip_rad_per_mps2: of the rear axle, until a pose says better.
        noise: what is taken to be random.
    """

    def __init__(
        self,
        config: OutputConfig,
        receiver: GnssReceiver = _NO_LEVER_ARM,
        slip_rad_per_mps2: float = 0.0,
        noise: NoiseModel = _CAR,
    ) -> None:
        self._config = config
        self._receiver = receiver
        if not config.pose_floor:
            noise = replace(noise, pose_floor_m=0.0, pose_floor_rad=0.0)
        if not config.learn_odometry:
            noise = replace(noise, speed_scale_sd=0.0, yaw_rate_offset_sd_radps=0.0)
        self._model = noise
        self._noise = noise.densities(receiver.config.sd_m, receiver.config.correlation_s)
        self._slip = slip_rad_per_mps2
        self._limits = gate_limits(config)
        self._buffer: ReplayBuffer[FilterState, Event] = ReplayBuffer(
            self._apply, horizon_s=config.horizon_s, capacity=4096
        )
        self._recent: deque[tuple[float, OdometryEvent]] = deque(maxlen=4096)
        self._start = GnssStart(receiver)

    # what comes in

    def add_odometry(
        self,
        stamp_s: float,
        speed_mps: float,
        yaw_rate_radps: float,
        *,
        doubted: bool = False,
        turn_doubted: bool = False,
    ) -> Placement | None:
        """Take odometry in, in doubt or not; None while the filter has not started."""
        event = OdometryEvent(speed_mps, yaw_rate_radps, doubted, turn_doubted)
        self._start.add_odometry(stamp_s, speed_mps, yaw_rate_radps)
        if self._buffer.started:
            return self._buffer.insert(stamp_s, event, kind=_ODOMETRY)
        self._recent.append((stamp_s, event))
        while self._recent[0][0] < stamp_s - self._config.horizon_s:
            self._recent.popleft()
        return None

    def add_pose(
        self,
        stamp_s: float,
        pose: Floats,
        covariance: Floats,
        slip_rad_per_mps2: float | None = None,
        *,
        held: bool = True,
    ) -> Placement:
        """Take a healthy pose `(3,)` of the rear axle with its covariance `(3, 3)` in.

        The first one starts the filter, or takes over from a start by GNSS. The caller has made
        sure with `usable_pose` that it can be used, and says whether its scan found mapped poles.
        """
        r = covariance
        a, b, c = float(r[0, 0]), float(r[0, 1]), float(r[0, 2])
        d, e, f = float(r[1, 1]), float(r[1, 2]), float(r[2, 2])
        floor_m2, floor_rad2 = self._model.pose_floor_m**2, self._model.pose_floor_rad**2
        event = PoseEvent(
            (float(pose[0]), float(pose[1]), wrap(float(pose[2]))),
            (a + floor_m2, b, c, d + floor_m2, e, f + floor_rad2),
            self._slip if slip_rad_per_mps2 is None else slip_rad_per_mps2,
            held,
        )
        if self._buffer.started:
            return self._buffer.insert(stamp_s, event, kind=_POSE)
        self._begin(stamp_s, event.pose, event.upper, by_pose=True)
        return Placement.APPENDED

    def add_gnss(
        self, stamp_s: float, east_m: float, north_m: float, hdop: float
    ) -> Placement | None:
        """Take a fix in: it starts the filter, bounds it while poses fail, and vetoes.

        None while the fixes do not yet show the heading.
        """
        sd = self._receiver.sd_m(hdop)
        self._start.add_fix(stamp_s, east_m, north_m, sd)
        if self._buffer.started:
            placed = self._buffer.insert(stamp_s, GnssEvent(east_m, north_m, sd), kind=_GNSS)
            state = self._buffer.state
            lasted = stamp_s - max(state.gnss_rejected_since_s, state.last_pose_s)
            after_s = _WRONG_RESTART_AFTER_S if state.gnss_wrong else _GNSS_RESTART_AFTER_S
            # what fixes alone say is asked for only where it would count
            found = self._start.pose_at_fix() if lasted >= after_s else None
            if found is not None:
                self._buffer.insert(stamp_s, RestartEvent(*found), kind=_RESTART)
            return placed
        found = self._start.pose_at_fix()
        if found is None:
            return None
        self._begin(stamp_s, *found, by_pose=False)
        return Placement.APPENDED

    # what goes out

    @property
    def started(self) -> bool:
        """Whether a pose, or fixes, have started it."""
        return self._buffer.started

    @property
    def newest(self) -> FilterState:
        """The state after the newest event."""
        return self._buffer.state

    def decision_at(self, stamp_s: float) -> tuple[str, float]:
        """What became of the last pose at or before `stamp_s`, and its NIS (three dimensions).

        The NIS is NaN for a pose that started the filter.
        """
        state = self._buffer.state_at(stamp_s)
        return state.decision, state.nis

    def predicted_to(self, stamp_s: float) -> FilterState:
        """Open-loop prediction from the last event at or before `stamp_s`.

        Raises:
            VehicleError: the filter has not started.
        """
        state = self._buffer.state_at(stamp_s)
        dt = min(stamp_s - state.stamp_s, _PREDICTED_MAX_S)
        if dt <= 0.0:
            return state
        mean, upper = ctrv_predict(
            state.mean, state.upper, dt, self._noise, state.slip_rad_per_mps2
        )
        return state._replace(stamp_s=stamp_s, mean=mean, upper=upper)

    # one event

    def _apply(self, state: FilterState, stamp_s: float, event: Event) -> FilterState:
        mean, upper = state.mean, state.upper
        dt = min(stamp_s - state.stamp_s, _PREDICTED_MAX_S)
        if dt > 0.0:
            mean, upper = ctrv_predict(mean, upper, dt, self._noise, state.slip_rad_per_mps2)
        if isinstance(event, OdometryEvent):
            return update_by_odometry(
                state, stamp_s, mean, upper, event, self._config, self._limits.odometry
            )
        state = state._replace(stamp_s=stamp_s, mean=mean, upper=upper)
        if isinstance(event, PoseEvent):
            state = state._replace(slip_rad_per_mps2=event.slip_rad_per_mps2)
            return update_by_pose(state, event, self._config, self._limits.pose)
        if isinstance(event, GnssEvent):
            return update_by_gnss(state, event, self._receiver, self._limits.gnss)
        counts = state.counts._replace(gnss_restarts=state.counts.gnss_restarts + 1)
        return reset_pose_by_fixes(reset_odometry(state), event.pose, event.upper)._replace(
            counts=counts
        )

    def _begin(self, stamp_s: float, pose: Pose, upper: PoseUpper, *, by_pose: bool) -> None:
        known = self._recent[-1][1] if self._recent else None
        speed, rate = known[:2] if known else (0.0, 0.0)
        spread = [1.0, 0.1] if known else [100.0, 1.0]
        wrong = (self._model.speed_scale_sd**2, self._model.yaw_rate_offset_sd_radps**2)
        fix = 2 * [self._receiver.config.sd_m**2]
        state = FilterState(
            stamp_s,
            (0.0, 0.0, 0.0, speed, rate, 0.0, 0.0, 0.0, 0.0),
            pack(np.diag([1.0, 1.0, 1.0, *spread, *wrong, *fix])),
            slip_rad_per_mps2=self._slip,
            odometry_s=self._recent[-1][0] if self._recent else NEVER,
            odometry_prior=wrong,
        )
        state = (reset_pose if by_pose else reset_pose_by_fixes)(state, pose, upper)
        self._buffer.reset(state._replace(decision="started"), stamp_s)
        for stamp, event in self._recent:
            if stamp > stamp_s:
                self._buffer.insert(stamp, event, kind=_ODOMETRY)
        self._recent.clear()


def usable_pose(stamp_s: float, pose: Floats, covariance: Floats) -> str | None:
    """Why a pose cannot be taken in ("not_finite", or nowhere; "bad_covariance"), or None."""
    # comparisons with what is not a number are false
    if not is_time(stamp_s) or not (np.abs(pose) <= FARTHEST_ON_EARTH_M).all():
        return "not_finite"
    known = is_covariance(covariance) and np.abs(covariance).max() <= FARTHEST_ON_EARTH_M**2
    return None if known else "bad_covariance"
