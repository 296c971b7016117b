"""The compiled steps of the CTRV filter against those in plain floats."""

import numpy as np
import pytest

from polemap.vehicle import ctrv, packed
from polemap.vehicle.packed import CtrvNoise, GaussMarkov, pack

NOISE = CtrvNoise(
    2.0, 0.3, 1e-4, along_s=2e-4, yaw_rad2ps=1e-5, turn_s=3e-4,
    scale=GaussMarkov(0.03, 40.0), offset_radps=GaussMarkov(0.005, 25.0),
    fix_m=GaussMarkov(2.5, 6.0),
)  # fmt: skip
pytestmark = pytest.mark.skipif(not ctrv.HAVE_KERNEL, reason="the kernel was not built here")


def test_the_kernel_equals_plain_floats_over_a_drive() -> None:
    rng = np.random.default_rng(4)
    root = rng.normal(size=(9, 9))
    start = tuple(rng.normal(0.0, 1.0, 9).tolist())
    slow = fast = (start, pack(root @ root.T + 0.1 * np.eye(9)))
    rows = [(3, 1.02, 5, 8.0), (4, 1.0, 6, 1.0), (3, 1.0, 5, 0.0), (2, 0.5, 7, 1.3)]
    for step in range(400):
        # at rest, straight on, in bends, and turning through pi; one sample, and a long silence
        speed, rate = (0.0, 0.0) if step % 50 < 5 else (float(rng.uniform(-3, 20)), 4.0)
        dt_s = 60.0 if step == 200 else float(rng.uniform(0.0, 0.05))
        slow, fast = (
            ((*mean[:3], speed, rate * (step % 3), *mean[5:]), upper)
            for mean, upper in (slow, fast)
        )
        slow = packed.ctrv_predict(*slow, dt_s, NOISE, 0.004)
        fast = ctrv.ctrv_predict(*fast, dt_s, NOISE, 0.004)
        row, residual = rows[step % 4], float(rng.normal(0.0, 0.5))
        slow = packed.update_by_two(*slow, row, residual, 0.04)
        fast = ctrv.update_by_two(*fast, row, residual, 0.04)
        ahead = tuple(rng.normal(0.0, 1.0, 9).tolist())
        pair = (ahead, (0.0, 1.0, *ahead[2:]), residual, -0.3, 0.5)
        slow_nis, *slow = packed.update_by_pair(*slow, *pair)
        fast_nis, *fast = ctrv.update_by_pair(*fast, *pair)
        assert fast_nis == pytest.approx(slow_nis, rel=1e-8)
        np.testing.assert_allclose(fast[0], slow[0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(fast[1], slow[1], rtol=1e-8, atol=1e-9)


def test_the_kernel_refuses_what_is_no_state() -> None:
    mean, upper = (0.0,) * 9, pack(np.eye(9))
    with pytest.raises(ValueError, match="upper is no tuple of 45"):
        ctrv.ctrv_predict(mean, upper[:9], 0.1, NOISE)
    with pytest.raises(ValueError, match="row names an entry"):
        ctrv.update_by_two(mean, upper, (3, 1.0, 9, 1.0), 0.1, 1.0)
    with pytest.raises(ZeroDivisionError):
        ctrv.update_by_two(mean, pack(np.zeros((9, 9))), (3, 1.0, 5, 0.0), 0.1, 0.0)


def test_a_fix_after_an_hour_leaves_a_covariance() -> None:
    """Variances of 1e9 m2 cancel in the short form of the update, and in a determinant."""
    mean = (147.0, 59.0, 0.4, 12.6, 0.1, 1.0, 0.0, 0.0, 0.0)
    upper = pack(np.diag([1.0, 1.0, 0.01, 0.5, 0.01, 1e-3, 1e-4, 6.0, 6.0]))
    mean, upper = ctrv.ctrv_predict(mean, upper, 3600.0, NOISE, 0.0)
    slow = (mean, upper)
    rows = ((1.0, 0.0, -0.4, *[0.0] * 4, 1.08, 0.0), (0.0, 1.0, 0.9, *[0.0] * 4, 0.0, 1.08))
    for _ in range(30):
        _, mean, upper = ctrv.update_by_pair(mean, upper, *rows, 0.3, -0.2, 0.29)
        _, *slow = packed.update_by_pair(*slow, *rows, 0.3, -0.2, 0.29)
        mean, upper = ctrv.ctrv_predict(mean, upper, 0.1, NOISE, 0.0)
        slow = packed.ctrv_predict(*slow, 0.1, NOISE, 0.0)
        assert np.linalg.eigvalsh(packed.unpack(upper)).min() > 0.0
    np.testing.assert_allclose(mean[:2], slow[0][:2], atol=1e-3)
