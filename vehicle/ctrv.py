"""The steps of the CTRV filter that run at every sample and again in every replay.

Compiled where the kernel is there; elsewhere in plain floats, `packed`, which is its oracle: both
add up in the same order, and give the same bits on x86 (`update_by_pair`: to rounding).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from polemap.extras import kernel
from polemap.vehicle import packed

if TYPE_CHECKING:
    ctrv_predict = packed.ctrv_predict
    update_by_two = packed.update_by_two
    update_by_pair = packed.update_by_pair
else:
    _steps = kernel("polemap.vehicle.native.packed_kernel") or packed
    ctrv_predict, update_by_two = _steps.ctrv_predict, _steps.update_by_two
    update_by_pair = _steps.update_by_pair

HAVE_KERNEL = ctrv_predict is not packed.ctrv_predict
