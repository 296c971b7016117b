from polemap.vehicle.packed import CtrvNoise, Mean, Upper

def ctrv_predict(
    mean: Mean, upper: Upper, dt_s: float, noise: CtrvNoise, slip: float = 0.0
) -> tuple[Mean, Upper]: ...
def update_by_two(
    mean: Mean,
    upper: Upper,
    row: tuple[int, float, int, float],
    residual: float,
    variance: float,
) -> tuple[Mean, Upper]: ...
def update_by_pair(
    mean: Mean,
    upper: Upper,
    row_one: Mean,
    row_two: Mean,
    residual_one: float,
    residual_two: float,
    variance: float,
) -> tuple[float, Mean, Upper]: ...
