from typing import Any

import numpy as np
from numpy.typing import NDArray

def assign_batch(
    costs: NDArray[np.float64], unassigned: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]: ...
def pole_log_likelihood(
    poses: Any,
    points: Any,
    covariance: Any,
    pole_width: Any,
    pole_log_gain: Any,
    map_points: Any,
    map_covariance: Any,
    map_width: Any,
    detection: Any,
    view: Any,
    free_range: Any,
    beta_p: float,
    width_sd: float,
    log_width_gain: float,
    want_assignment: bool = False,
    threads: int = 1,
) -> tuple[
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.int32],
    NDArray[np.int32],
]: ...
