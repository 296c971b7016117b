"""Optimal one-to-one assignment (Jonker and Volgenant), of one problem or of many.

The C++ kernel does the work where it was built; plain numpy and scipy say the same, slowly, and
are the tests' oracle.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

try:
    from polemap.localize.particle_filter.native import assignment_kernel

    HAVE_KERNEL = True
except ImportError:  # no compiler at install time: the scipy path serves
    HAVE_KERNEL = False

__all__ = ["HAVE_KERNEL", "Backend", "assign", "assignment_kernel", "use_kernel"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

Backend = Literal["auto", "native", "scipy"]


def assign(
    costs: Floats, unassigned: Floats | float, *, backend: Backend = "auto"
) -> tuple[Floats, Ints]:
    """Solve assignment problems in which a row may also be left alone, at a price.

    Args:
        costs: `(b, r, c)`, or `(r, c)` for a single problem; `inf` forbids a pair.
        unassigned: price of leaving a row alone, broadcast to `(b, r)`; `inf` forbids it.
        backend: `auto` takes the kernel where it exists.

    Returns:
        The least total cost `(b,)` and the column of every row `(b, r)`, -1 where left alone. For
        a single problem the leading axis is dropped.

    Raises:
        ValueError: a cost is NaN or minus infinity, or no assignment of finite cost exists.

    Source: Jonker and Volgenant (1987).
    """
    stacked = np.asarray(costs, dtype=np.float64)
    single = stacked.ndim == 2
    stacked = stacked[np.newaxis] if single else stacked
    if stacked.ndim != 3:
        raise ValueError(f"costs has {stacked.ndim} axes, expected (b, r, c) or (r, c)")
    price = np.ascontiguousarray(
        np.broadcast_to(np.asarray(unassigned, dtype=np.float64), stacked.shape[:2])
    )
    if use_kernel(backend):
        totals, matches = assignment_kernel.assign_batch(stacked, price)
    else:
        totals, matches = _assign_scipy(stacked, price)
    return (totals[0], matches[0]) if single else (totals, matches)


def use_kernel(backend: Backend) -> bool:
    """Whether the C++ kernel does the work.

    Raises:
        ValueError: it was asked for, and was not built.
    """
    if backend == "native" and not HAVE_KERNEL:
        raise ValueError("the assignment kernel was not built; use the backend 'scipy'")
    return HAVE_KERNEL and backend != "scipy"


def _assign_scipy(costs: Floats, unassigned: Floats) -> tuple[Floats, Ints]:
    batch, rows, columns = costs.shape
    totals = np.zeros(batch)
    matches = np.full((batch, rows), -1, dtype=np.int32)
    for b in range(batch):
        alone = np.full((rows, rows), np.inf)
        np.fill_diagonal(alone, unassigned[b])
        padded = np.hstack([costs[b], alone])
        if np.isnan(padded).any() or np.isneginf(padded).any():
            raise ValueError(f"problem {b} has a cost that is NaN or minus infinity")
        try:
            row, column = scipy.optimize.linear_sum_assignment(padded)
        except ValueError as error:
            raise ValueError(f"problem {b} has no assignment of finite cost") from error
        totals[b] = padded[row, column].sum()
        matches[b, row] = np.where(column < columns, column, -1)
    return totals, matches
