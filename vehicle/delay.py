"""Late measurements, exactly: replay over a bounded horizon, and clones at fixed cost.

`ReplayBuffer` keeps the events of the last moments with the state after each. A late event is put
where its stamp says and what follows is done again: the result equals processing in time order,
whatever the model. `ClonedFilter` needs a linear model and a known capture time, and costs the
same at every step: it carries a copy of what the camera saw along as extra states.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable
from enum import Enum
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.errors import VehicleError
from polemap.vehicle.kalman import innovate, joseph_update, predict

State = TypeVar("State")
Event = TypeVar("Event")
Floats = NDArray[np.float64]


class Placement(Enum):
    """Where an event went."""

    APPENDED = "appended"  # it is the newest
    REPLAYED = "replayed"  # it was late; what follows was done again
    TOO_OLD = "too_old"  # older than the horizon; dropped
    DUPLICATE = "duplicate"  # one of the same stamp and kind is there; dropped


# sort before and behind every kind of the same stamp
_FIRST_KIND, _LAST_KIND = -(2**62), 2**62


class ReplayBuffer(Generic[State, Event]):
    """States of a filter over the last `horizon_s`, redone when an event comes late.

    Args:
        apply: `(state, stamp_s, event) -> state`: brings a state to the event's stamp and takes
            the event in. It must return a new state and leave the old one as it is.
        horizon_s: how much older than the newest event a late one may be.
        capacity: most events kept; memory is fixed by it. When it is reached, the oldest are
            folded into the base and the horizon is shorter than asked for.

    Raises:
        VehicleError: a horizon or a capacity that is not positive.
    """

    def __init__(
        self,
        apply: Callable[[State, float, Event], State],
        *,
        horizon_s: float,
        capacity: int = 1024,
    ) -> None:
        if not horizon_s > 0.0 or capacity < 1:
            raise VehicleError(
                f"replay needs a positive horizon and capacity, not {horizon_s} s and {capacity}"
            )
        self._apply = apply
        self._horizon_s = horizon_s
        self._capacity = capacity
        self._keys: list[tuple[float, int]] = []
        self._events: list[Event] = []
        self._states: list[State] = []
        self._base: State | None = None
        self._base_key = (float("-inf"), _FIRST_KIND)

    def __len__(self) -> int:
        return len(self._keys)

    @property
    def started(self) -> bool:
        """Whether there is a state."""
        return self._base is not None

    @property
    def state(self) -> State:
        """The state after the newest event.

        Raises:
            VehicleError: nothing was started.
        """
        if self._states:
            return self._states[-1]
        if self._base is None:
            raise VehicleError("the replay buffer holds no state before it is reset to one")
        return self._base

    @property
    def newest_stamp_s(self) -> float:
        """Stamp of the newest event, or of the base."""
        return self._keys[-1][0] if self._keys else self._base_key[0]

    @property
    def oldest_stamp_s(self) -> float:
        """Stamp before which events are too old."""
        return self._base_key[0]

    def reset(self, state: State, stamp_s: float) -> None:
        """Forget everything and start from `state` at `stamp_s`."""
        self._keys.clear()
        self._events.clear()
        self._states.clear()
        self._base, self._base_key = state, (stamp_s, _FIRST_KIND)

    def state_at(self, stamp_s: float) -> State:
        """The state after the last event at or before `stamp_s`; the base if there is none."""
        index = bisect_right(self._keys, (stamp_s, _LAST_KIND))
        if index:
            return self._states[index - 1]
        if self._base is None:
            raise VehicleError("the replay buffer holds no state before it is reset to one")
        return self._base

    def insert(self, stamp_s: float, event: Event, *, kind: int = 0) -> Placement:
        """Take an event in at its stamp.

        `kind` orders events of equal stamp, small first, and tells duplicates from events of
        different sensors.

        Raises:
            VehicleError: nothing was started.
        """
        if self._base is None:
            raise VehicleError("the replay buffer holds no state before it is reset to one")
        key = (stamp_s, kind)
        if key <= self._base_key or stamp_s < self.newest_stamp_s - self._horizon_s:
            return Placement.TOO_OLD
        keys = self._keys
        if not keys or key > keys[-1]:
            self._states.append(self._apply(self.state, stamp_s, event))
            keys.append(key)
            self._events.append(event)
            self._fold()
            return Placement.APPENDED
        index = bisect_left(keys, key)
        if keys[index] == key:
            return Placement.DUPLICATE
        state = self._states[index - 1] if index else self._base
        redone = [self._apply(state, stamp_s, event)]
        for later_key, later in zip(keys[index:], self._events[index:], strict=True):
            redone.append(self._apply(redone[-1], later_key[0], later))
        # nothing above may have changed the lists: an event that fails leaves them as they were
        self._states[index:] = redone
        keys.insert(index, key)
        self._events.insert(index, event)
        self._fold()
        return Placement.REPLAYED

    def _fold(self) -> None:
        """Move what fell out of the horizon, or does not fit, into the base."""
        keys = self._keys
        limit = keys[-1][0] - self._horizon_s
        count = max(0, len(keys) - self._capacity)
        while count < len(keys) - 1 and keys[count][0] < limit:
            count += 1
        if count:
            self._base, self._base_key = self._states[count - 1], keys[count - 1]
            del keys[:count], self._events[:count], self._states[:count]


class ClonedFilter:
    """A linear Kalman filter that carries clones of past outputs as extra states.

    The state is `[x, S x(t1), S x(t2), ...]` with one slot for each measurement on its way. A
    measurement of `S x` at its capture time, arriving later, updates through its slot: this equals
    the exact out-of-sequence filter at constant cost.

    Args:
        state: `(n,)`.
        covariance: `(n, n)`.
        selection: S `(m, n)`, what the late sensor sees of the state.
        slots: captures that may be on their way at once (delay over frame period, rounded up,
            plus one).

    Source: W12 (10)-(12) as corrected in errata.md, Delay by cloning.
    """

    def __init__(
        self, state: Floats, covariance: Floats, selection: Floats, *, slots: int = 1
    ) -> None:
        n, m = len(state), len(selection)
        if selection.shape != (m, n) or covariance.shape != (n, n) or slots < 1:
            raise VehicleError(
                f"clones: state {state.shape}, covariance {covariance.shape}, selection "
                f"{selection.shape} and {slots} slots do not fit"
            )
        self._n, self._m = n, m
        self._selection = selection
        self._x = np.zeros(n + slots * m)
        self._p = np.zeros((n + slots * m, n + slots * m))
        self._x[:n] = state
        self._p[:n, :n] = covariance
        self._owners: list[int | None] = [None] * slots

    @property
    def state(self) -> Floats:
        """`(n,)`, a copy."""
        return self._x[: self._n].copy()

    @property
    def covariance(self) -> Floats:
        """`(n, n)`, a copy."""
        return self._p[: self._n, : self._n].copy()

    def predict(self, transition: Floats, noise: Floats, drive: Floats | None = None) -> None:
        """One step `x+ = G x + drive`, `drive` being H u; clones hold still."""
        n = self._n
        self._x[:n] = (
            transition @ self._x[:n] if drive is None else transition @ self._x[:n] + drive
        )
        self._p[:n, :n] = predict(self._p[:n, :n], transition, noise)
        cross = transition @ self._p[:n, n:]
        self._p[:n, n:] = cross
        self._p[n:, :n] = cross.T

    def measure(self, measured: Floats, jacobian: Floats, noise: Floats) -> float:
        """A measurement `(k,)` of now with `jacobian` `(k, n)`; returns its NIS."""
        wide = np.zeros((len(measured), len(self._x)))
        wide[:, : self._n] = jacobian
        return self._update(measured, wide, noise)

    def capture(self, token: int) -> None:
        """Clone `S x` of now under `token`. Process an arrival of the same step first.

        The oldest capture is given up where no slot is free.
        """
        slot = self._owners.index(None) if None in self._owners else self._oldest()
        self._owners[slot] = token
        rows = slice(self._n + slot * self._m, self._n + (slot + 1) * self._m)
        s = self._selection
        self._x[rows] = s @ self._x[: self._n]
        self._p[rows, :] = s @ self._p[: self._n, :]
        self._p[:, rows] = self._p[:, : self._n] @ s.T
        self._p[rows, rows] = s @ self._p[: self._n, : self._n] @ s.T

    def arrive(self, token: int, measured: Floats, noise: Floats) -> float | None:
        """The measurement `(m,)` of the capture `token` arrives; its NIS, or None if given up."""
        if token not in self._owners:
            return None
        slot = self._owners.index(token)
        self._owners[slot] = None
        wide = np.zeros((self._m, len(self._x)))
        start = self._n + slot * self._m
        wide[:, start : start + self._m] = np.eye(self._m)
        nis = self._update(measured, wide, noise)
        # a free slot must not bear on anything: its rows are written anew at the next capture
        rows = slice(start, start + self._m)
        self._x[rows] = 0.0
        self._p[rows, :] = 0.0
        self._p[:, rows] = 0.0
        return nis

    def _oldest(self) -> int:
        tokens = [owner for owner in self._owners if owner is not None]
        return self._owners.index(min(tokens))

    def _update(self, measured: Floats, wide: Floats, noise: Floats) -> float:
        innovation = innovate(measured - wide @ self._x, self._p, wide, noise)
        self._x, self._p = joseph_update(self._x, self._p, innovation, wide, noise)
        return innovation.nis
