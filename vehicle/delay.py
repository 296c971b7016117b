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
from math import sqrt
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from polemap.vehicle.errors import VehicleError

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
    the exact out-of-sequence filter at constant cost. It runs a thousand times a second, so the
    buffers are laid out once and a step is few small array operations; `kalman` has the plain form.

    Args:
        state: `(n,)`.
        covariance: `(n, n)`.
        selection: S `(m, n)`, what the late sensor sees of the state.
        slots: captures that may be on their way at once (delay over frame period, rounded up,
            plus one); 0 where nothing is late.

    Attributes:
        x: `(n + slots m,)`.
        p: `(n + slots m, n + slots m)`.

    Raises:
        VehicleError: shapes that do not fit.

    Source: W12 (10)-(12) as corrected in errata.md, Delay by cloning.
    """

    def __init__(self, state: Floats, covariance: Floats, selection: Floats, slots: int) -> None:
        n, m = len(state), len(selection)
        if selection.shape != (m, n) or covariance.shape != (n, n) or slots < 0:
            raise VehicleError(
                f"clones: state {state.shape}, covariance {covariance.shape}, selection "
                f"{selection.shape} and {slots} slots do not fit"
            )
        size = n + m * slots
        self.size, self.n, self.m, self.slots = size, n, m, slots
        self.x = np.zeros(size)
        self.x[:n] = state
        self.p = np.zeros((size, size))
        self.p[:n, :n] = covariance
        self._g, self._eye = np.eye(size), np.eye(size)
        self._g_transposed = self._g.T
        self._work, self._vector = np.zeros((size, size)), np.zeros(size)
        self._outer, self._row = np.zeros((size, size)), np.zeros(size)
        self._g_state, self._p_state = self._g[:n, :n], self.p[:n, :n]
        self._x_state = self.x[:n]
        self.selection = selection
        self.owners: list[float | None] = [None] * slots

    def predict(self, transition: Floats, driven: Floats, noise: Floats) -> None:
        """`x+ = G x + driven`, `P+ = G P G' + Q`; clones hold."""
        self._g_state[:] = transition
        np.dot(self._g, self.x, out=self._vector)
        self.x[:] = self._vector
        self._x_state += driven
        np.dot(self._g, self.p, out=self._work)
        np.dot(self._work, self._g_transposed, out=self.p)
        self._p_state += noise

    def scalar(self, index: int, measured: float, variance: float) -> None:
        """A direct measurement of one state: `P - (P h)(P h)' / s` is the short form for it."""
        row = self._row
        row[:] = self.p[index]
        s = row.item(index) + variance
        gain = (measured - self.x.item(index)) / s
        np.multiply.outer(row, row, out=self._outer)
        self._outer /= s
        self.p -= self._outer
        row *= gain
        self.x += row

    def row(
        self, jacobian: Floats, residual: float, variance: float, outlier_sd: float = float("inf")
    ) -> bool:
        """A measurement of one number with `jacobian` `(size,)`, in the short form of `scalar`.

        One beyond `outlier_sd` of its predicted deviations is weighed down as Huber has it.

        Returns:
            Whether it was.
        """
        cross = self._row
        np.dot(self.p, jacobian, out=cross)
        s = float(jacobian.dot(cross)) + variance
        wild = residual * residual > outlier_sd * outlier_sd * s
        if wild:
            s = abs(residual) * sqrt(s) / outlier_sd
        np.multiply.outer(cross, cross, out=self._outer)
        self._outer /= s
        self.p -= self._outer
        cross *= residual / s
        self.x += cross
        return wild

    def capture(self, stamp_s: float) -> None:
        """Clone `S x`; the oldest capture is given up where no slot is free."""
        owners = self.owners
        if None in owners:
            slot = owners.index(None)
        else:
            slot = min(range(self.slots), key=lambda i: owners[i] or 0.0)
        owners[slot] = stamp_s
        rows = slice(self.n + slot * self.m, self.n + (slot + 1) * self.m)
        s, n = self.selection, self.n
        self.p += self.p.T.copy()
        self.p *= 0.5
        self.x[rows] = s @ self.x[:n]
        self.p[rows, :] = s @ self.p[:n, :]
        self.p[:, rows] = self.p[rows, :].T
        self.p[rows, rows] = s @ self.p[:n, :n] @ s.T

    def clone(self, stamp_s: float) -> slice | None:
        """Where the capture of `stamp_s` lies in the state."""
        for slot, owner in enumerate(self.owners):
            if owner is not None and abs(owner - stamp_s) < 1e-6:
                return slice(self.n + slot * self.m, self.n + (slot + 1) * self.m)
        return None

    def update(self, jacobian: Floats, residual: Floats, noise: Floats) -> None:
        """Joseph update with `jacobian` `(k, size)`."""
        cross = self.p @ jacobian.T
        s = jacobian @ cross
        s += noise
        if len(s) == 2:
            # by hand: LAPACK's call costs more than all the rest of the step
            a, b, c, d = s.ravel().tolist()
            gain = cross @ np.array([[d, -b], [-c, a]])
            gain /= a * d - b * c
        else:
            gain = np.linalg.solve(s, cross.T).T
        keep = self._eye - gain @ jacobian
        p = keep @ self.p @ keep.T
        p += gain @ noise @ gain.T
        p += p.T.copy()
        np.multiply(p, 0.5, out=self.p)
        self.x += gain @ residual

    def release(self, stamp_s: float) -> None:
        """Free the slot of a capture; it must not bear on anything any more."""
        rows = self.clone(stamp_s)
        if rows is not None:
            self.owners[(rows.start - self.n) // self.m] = None
            self.x[rows] = 0.0
            self.p[rows, :] = 0.0
            self.p[:, rows] = 0.0
