import math

import numpy as np
import pytest

from polemap.localize.clocks import FUTURE_S, STEP_SAMPLES, StreamClock


def feed(clock, stamps, arrivals):
    return [clock.checked_stamp(s, a) for s, a in zip(stamps, arrivals, strict=True)]


def test_a_good_clock_is_left_alone():
    clock = StreamClock()
    stamps = np.arange(500) * 0.02
    late = np.random.default_rng(1).exponential(0.03, 500)
    assert feed(clock, stamps, stamps + late) == stamps.tolist()
    assert not clock.counts


def test_nan_is_dropped_and_counted():
    clock = StreamClock()
    assert feed(clock, [math.nan, 0.0, 1.0], [0.0, math.inf, 1.0]) == [None, None, 1.0]
    assert clock.counts["not_finite"] == 2


def test_a_single_stamp_from_the_future_is_dropped():
    clock = StreamClock()
    stamps = np.arange(100) * 0.02
    stamps[50] += 0.5
    used = feed(clock, stamps, np.arange(100) * 0.02)
    assert used[50] is None
    assert used.count(None) == 1
    assert clock.counts == {"future": 1}


@pytest.mark.parametrize(("step", "kind"), [(1.0, "future"), (-1.0, "clock_backwards")])
def test_a_clock_that_steps_and_stays_is_followed(step, kind):
    clock = StreamClock()
    true = np.arange(200) * 0.02
    stamps = true + np.where(true >= 2.0, step, 0.0)
    used = feed(clock, stamps, true + 0.01)
    dropped = [i for i, stamp in enumerate(used) if stamp is None]
    assert dropped == list(range(100, 100 + STEP_SAMPLES - 1))
    assert clock.counts[kind] == len(dropped)
    assert clock.counts["clock_steps"] == 1
    assert np.allclose(used[110:], true[110:], atol=0.005)


def test_a_burst_of_late_samples_is_no_step():
    clock = StreamClock()
    true = np.arange(200) * 0.045
    arrivals = true + 0.1
    arrivals[80:125] = arrivals[125]  # two seconds of them arrive at once
    used = feed(clock, true, arrivals)
    assert used == true.tolist()
    assert clock.counts["clock_steps"] == 0
    assert clock.counts["silences"] == 1
    assert clock.silent_s == pytest.approx(2.0, abs=0.1)


def test_a_clock_that_runs_fast_is_brought_back_when_it_reaches_the_future():
    clock = StreamClock()
    true = np.arange(20_000) * 0.02
    used = feed(clock, true * (1 + 500e-6), true + 0.01)
    errors = np.array([u - t for u, t in zip(used, true, strict=True) if u is not None])
    assert errors.max() <= 0.01 + FUTURE_S + 1e-9
    assert clock.counts["clock_steps"] >= 2
    assert sum(stamp is None for stamp in used) < 50
