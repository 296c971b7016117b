import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polemap.vehicle.delay import ClonedFilter, Placement, ReplayBuffer
from polemap.vehicle.errors import VehicleError
from polemap.vehicle.kalman import innovate, joseph_update, predict


def recording(state, stamp_s, event):
    """A state that remembers everything: replay is right only if the tuple is in order."""
    return (*state, (stamp_s, event))


@given(st.permutations(range(12)))
def test_any_arrival_order_within_the_horizon_gives_the_same_history(order):
    buffer = ReplayBuffer(recording, horizon_s=100.0)
    buffer.reset((), -1.0)
    for i in order:
        # two kinds at every stamp: equal stamps must fall in the order of their kinds
        buffer.insert(float(i // 2), f"event {i}", kind=i % 2)
    assert buffer.state == tuple((float(i // 2), f"event {i}") for i in range(12))


def test_memory_is_fixed_and_the_horizon_bounded():
    buffer = ReplayBuffer(lambda state, _stamp, event: state + event, horizon_s=1.0, capacity=50)
    buffer.reset(0, 0.0)
    for i in range(1, 1001):
        assert buffer.insert(i * 0.01, 1) is Placement.APPENDED
        assert len(buffer) <= 50
    assert buffer.state == 1000
    assert buffer.insert(9.495, 1) is Placement.TOO_OLD, "the capacity has shortened the horizon"
    assert buffer.insert(9.805, 1) is Placement.REPLAYED
    assert buffer.state == 1001


def test_too_old_is_measured_from_the_newest_event():
    buffer = ReplayBuffer(recording, horizon_s=0.5)
    buffer.reset((), 0.0)
    buffer.insert(1.0, "a")
    assert buffer.insert(0.49, "late") is Placement.TOO_OLD
    assert buffer.insert(0.51, "b") is Placement.REPLAYED
    assert buffer.insert(0.51, "again") is Placement.DUPLICATE
    assert buffer.state == ((0.51, "b"), (1.0, "a"))


def test_the_state_at_a_moment_is_the_one_after_the_last_event_before():
    buffer = ReplayBuffer(recording, horizon_s=10.0)
    buffer.reset(("start",), 0.0)
    buffer.insert(1.0, "a")
    buffer.insert(2.0, "b")
    assert buffer.state_at(0.5) == ("start",)
    assert buffer.state_at(1.0) == ("start", (1.0, "a"))
    assert buffer.state_at(9.0) == buffer.state
    assert buffer.newest_stamp_s == 2.0


def test_an_event_that_fails_leaves_the_buffer_as_it_was():
    def picky(state, stamp_s, event):
        if event == "bad":
            raise VehicleError("no")
        return recording(state, stamp_s, event)

    buffer = ReplayBuffer(picky, horizon_s=10.0)
    buffer.reset((), 0.0)
    buffer.insert(1.0, "a")
    buffer.insert(2.0, "b")
    for stamp in (1.5, 3.0):
        with pytest.raises(VehicleError):
            buffer.insert(stamp, "bad")
    assert buffer.state == ((1.0, "a"), (2.0, "b"))
    assert len(buffer) == 2


def test_use_before_a_start_and_bad_sizes_are_refused():
    buffer = ReplayBuffer(recording, horizon_s=1.0)
    assert not buffer.started
    for use in (lambda: buffer.state, lambda: buffer.insert(0.0, "a"), lambda: buffer.state_at(0)):
        with pytest.raises(VehicleError, match="holds no state before it is reset"):
            use()
    with pytest.raises(VehicleError, match="positive horizon and capacity"):
        ReplayBuffer(recording, horizon_s=0.0)


def linear_model(rng):
    n = 4
    transition = np.eye(n) + 0.05 * rng.normal(size=(n, n))
    root = 0.1 * rng.normal(size=(n, n))
    return transition, root @ root.T + 1e-4 * np.eye(n)


@given(st.integers(0, 1000), st.sampled_from([[3], [1], [2, 5, 1, 4], [7, 2]]))
def test_clones_equal_replay(seed, delays):
    """Fast measurements at every step, slow ones captured every third step and late."""
    rng = np.random.default_rng(seed)
    transition, noise = linear_model(rng)
    fast, slow = rng.normal(size=(1, 4)), rng.normal(size=(2, 4))
    r_fast, r_slow = np.eye(1) * 0.2, np.eye(2) * 0.1
    start, spread = rng.normal(size=4), np.eye(4)

    def apply(state, stamp_s, event):
        x, p, at = state
        for _ in range(round(stamp_s) - at):
            x, p = transition @ x, predict(p, transition, noise)
        h, z, r = event
        innovation = innovate(z - h @ x, p, h, r)
        return (*joseph_update(x, p, innovation, h, r), round(stamp_s))

    buffer = ReplayBuffer(apply, horizon_s=1000.0)
    buffer.reset((start, spread, 0), 0.0)
    clones = ClonedFilter(start, spread, slow, slots=4)
    pending = {}
    for step in range(1, 40):
        clones.predict(transition, np.zeros(4), noise)
        z_fast = rng.normal(size=1)
        buffer.insert(step, (fast, z_fast, r_fast), kind=0)
        wide = np.zeros((1, clones.size))
        wide[:, :4] = fast
        clones.update(wide, z_fast - wide @ clones.x, r_fast)
        for capture in pending.pop(step, []):
            z_slow = rng.normal(size=2)
            buffer.insert(capture, (slow, z_slow, r_slow), kind=1)
            assert arrive(clones, capture, z_slow, r_slow)
        if step % 3 == 0:
            clones.capture(step)
            pending.setdefault(step + delays[(step // 3) % len(delays)], []).append(step)
        x, p, _ = buffer.state
        assert np.allclose(clones.x[:4], x, atol=1e-9, rtol=1e-9)
        assert np.allclose(clones.p[:4, :4], p, atol=1e-9, rtol=1e-9)


def arrive(clones, capture, measured, noise):
    """Whether the capture was still there; updates through its slot and frees it."""
    rows = clones.clone(capture)
    if rows is None:
        return False
    wide = np.zeros((len(measured), clones.size))
    wide[:, rows] = np.eye(len(measured))
    clones.update(wide, measured - clones.x[rows], noise)
    clones.release(capture)
    return True


@given(st.integers(0, 1000))
def test_a_direct_measurement_in_short_equals_the_update_with_its_row(seed):
    rng = np.random.default_rng(seed)
    transition, noise = linear_model(rng)
    one, two = (ClonedFilter(np.zeros(4), np.eye(4), np.eye(4)[:2], slots=1) for _ in "ab")
    for clones in (one, two):
        clones.capture(0.0)
        clones.predict(transition, np.ones(4), noise)
    row = np.eye(1, one.size, 1)
    one.scalar(1, 0.7, 0.3)
    two.update(row, 0.7 - row @ two.x, np.array([[0.3]]))
    assert np.allclose(one.x, two.x, atol=1e-12)
    assert np.allclose(one.p, two.p, atol=1e-12)


def test_a_capture_beyond_the_slots_gives_up_the_oldest():
    clones = ClonedFilter(np.zeros(2), np.eye(2), np.eye(2)[:1], slots=2)
    for token in (1.0, 2.0, 3.0):
        clones.predict(np.eye(2), np.zeros(2), 0.1 * np.eye(2))
        clones.capture(token)
    assert not arrive(clones, 1.0, np.ones(1), np.eye(1))
    assert arrive(clones, 2.0, np.ones(1), np.eye(1))
    # the prior of the capture is 1.2, so the gain is 1.2 / 2.2
    assert clones.x[0] == pytest.approx(1.2 / 2.2)


def test_clones_that_do_not_fit_are_refused():
    with pytest.raises(VehicleError, match="do not fit"):
        ClonedFilter(np.zeros(2), np.eye(3), np.eye(2), slots=1)
