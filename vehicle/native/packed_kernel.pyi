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
