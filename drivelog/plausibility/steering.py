"""The wheelbase against the steering, where a signal log lies beside the drive.

Gently driven, the road wheels stand at delta = L r / v + K v r (L wheelbase, r yaw rate, v speed,
K understeer gradient), whatever the tyres, and ahead of that while the car begins to turn. No other
stream shows the wheelbase.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polemap.drivelog.drive import Drive
from polemap.drivelog.errors import PolemapError
from polemap.drivelog.findings import Finding
from polemap.drivelog.tables import Table, read_table

Floats = NDArray[np.float64]

_FILE = "signals.csv"
_SPEED_MPS, _LATERAL_MPS2, _CURVATURE_PER_M = 2.0, 4.0, 0.02
_ROWS_MIN, _ROWS_MAX, _TURNED_MIN_RAD = 100, 5000, 1.5
# rad per m/s2: cars understeer by about this
_UNDERSTEER, _UNDERSTEER_SD = 0.002, 0.002
# rad per rad/s2: yaw inertia over what the front tyres turn
_BEGINNING_SD_S2 = 0.05
# simulated cars 0.98 to 1.02; a toe angle or a worn steering gives a few percent
_DOUBT, _EXPLAINED = 1.25, 0.8
# beyond this it is another angle's unit or the angle of the steering wheel, no wheelbase
_ANOTHER_ANGLE = 5.0


def wheelbase_findings(drive: Drive) -> list[Finding]:
    """A wheelbase that the road-wheel angles of signals.csv contradict."""
    path = drive.path / _FILE
    if not path.is_file():
        return []
    names = ("stamp_s", "road_wheel_angle_rad", "yaw_rate_radps", "vx_mps")
    try:
        log = read_table(path, names)
    except PolemapError:
        # a log of its own, which `polemap estimate` reads and judges
        return []
    seen = find_wheelbase_m(log)
    if seen is None or drive.wheelbase_m <= 0.0:
        return []
    ratio = drive.wheelbase_m / seen
    if 1.0 / _DOUBT < ratio < _DOUBT or not 1.0 / _ANOTHER_ANGLE < ratio < _ANOTHER_ANGLE:
        return []
    return [
        Finding(
            "wheelbase", "warning", drive.names.head,
            f"wheelbase_m is {drive.wheelbase_m:g}, steering, speed and yaw rate of {_FILE} show "
            f"{seen:.2f} m", f"the same within {100 * (_DOUBT - 1):.0f} %",
            "write the distance from rear to front axle, or mend the angle's unit",
        )
    ]  # fmt: skip


def find_wheelbase_m(log: Table) -> float | None:
    """The wheelbase that a log's bends show; None where it has too few, or they do not fit."""
    angle, rate, speed = (log[n] for n in ("road_wheel_angle_rad", "yaw_rate_radps", "vx_mps"))
    gentle = (speed > _SPEED_MPS) & (np.abs(speed * rate) < _LATERAL_MPS2)
    bends = gentle & (np.abs(rate) > _CURVATURE_PER_M * np.abs(speed))
    rows = np.flatnonzero(bends)
    step = float(np.median(np.diff(log["stamp_s"]))) if len(log) > 1 else 0.0
    # swerves are over before the car has settled into them
    if len(rows) < _ROWS_MIN or float(np.abs(rate[rows]).sum()) * step < _TURNED_MIN_RAD:
        return None
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, _ROWS_MAX).astype(np.int64))]
    begins = np.gradient(rate, log["stamp_s"])[rows]
    angle, rate, speed = angle[rows], rate[rows], speed[rows]
    design = np.stack([rate / speed, speed * rate, begins, np.ones(len(rows))], axis=1)
    prior = np.diag([1e-9, _UNDERSTEER_SD**-2, _BEGINNING_SD_S2**-2, 1.0])
    weight: Floats = np.full(len(rows), 1e4)
    fit: Floats = np.zeros(4)
    for _ in range(10):
        total = (design * weight[:, None]).T @ design + prior
        vector = design.T @ (weight * angle) + prior @ [0.0, _UNDERSTEER, 0.0, 0.0]
        fit = np.asarray(np.linalg.solve(total, vector))
        rest = np.abs(angle - design @ fit)
        scale = 1.4826 * float(np.median(rest)) + 1e-4
        weight = 1.0 / (1.0 + (rest / (2.0 * scale)) ** 2) / scale**2
    spread = float(np.median(np.abs(angle - np.median(angle))))
    unexplained = float(np.median(np.abs(angle - design @ fit)))
    if unexplained > (1.0 - _EXPLAINED) * spread or not fit[0] > 0.0:
        return None
    return float(fit[0])
