"""Odometry into the output filter: measured, gated, and at standstill more than that.

This runs for every odometry event and again in every replay, so it is written in plain floats.
"""

from __future__ import annotations

from polemap.localize.output_filter.config import OutputConfig
from polemap.localize.output_filter.gate import fails_gate
from polemap.localize.output_filter.state import FilterState, OdometryEvent
from polemap.vehicle.ctrv import update_by_two
from polemap.vehicle.packed import INDEX, Mean, Upper

# rows of the state, see `vehicle.packed`
_SPEED, _RATE, _SCALE, _OFFSET = 3, 4, 5, 6
_MOVING_RATE = (_RATE, 1.0, _OFFSET, 1.0)
# slower than this the car stands: wheel encoders of cars show nothing below a few cm/s
_STANDSTILL_MPS = 0.02
# ... and stands for so long before it counts: a wheel that locks does not stay locked, or the poles
# have contradicted it by then; a standing car's yaw rate shows this much beside its offset
_STANDSTILL_S, _STILL_TURN_RADPS = 0.5, 0.005
# noise of a yaw rate whose speed is in doubt: it may come from the same wheels
_DOUBTED_RADPS, _DOUBTED_SHARE = 0.02, 0.3
# so long after the last pose on poles a doubted turn is better than none
_ALONE_AFTER_S = 10.0
REJECTIONS_MAX = 10
"""Samples in a row that may fail the gate; then odometry is believed. A fifth of a second at 50 Hz:
longer than a slipping wheel at a kerb, shorter than the poses are kept waiting."""
# what a standing car does
_STILL_SPEED_VARIANCE, _STILL_RATE_VARIANCE = 0.005**2, 0.0005**2


def update_by_odometry(
    state: FilterState,
    stamp_s: float,
    mean: Mean,
    upper: Upper,
    event: OdometryEvent,
    config: OutputConfig,
    limit: float,
) -> FilterState:
    """The state after odometry at `stamp_s`, to which `mean` and `upper` have been predicted.

    Args:
        limit: of the gate, on the squared distance of speed and yaw rate.
    """
    speed, rate, doubted, turn_doubted = event
    counts, rejected = state.counts, 0
    still_since_s = float("inf")
    if abs(speed) <= _STANDSTILL_MPS and not (doubted or turn_doubted):
        still_since_s = min(state.still_since_s, stamp_s)
    # a standstill takes several signals and some time: no speed, no turn, and no contradiction
    standing = stamp_s - still_since_s >= _STANDSTILL_S and _offset_explains(mean, upper, rate)
    if standing:
        speed = 0.0
        row_v, row_w = (_SPEED, 1.0, _SCALE, 0.0), (_RATE, 1.0, _OFFSET, 0.0)
        rv, rw = _STILL_SPEED_VARIANCE, _STILL_RATE_VARIANCE
        expected_v, expected_w, seen_w = mean[3], mean[4], 0.0
    else:
        row_v, row_w = (_SPEED, 1.0 + mean[5], _SCALE, mean[3]), _MOVING_RATE
        rv = config.speed_sd_mps**2
        rw = config.yaw_rate_sd_radps**2
        expected_v, expected_w, seen_w = mean[3] * (1.0 + mean[5]), mean[4] + mean[6], rate
    dv, dw = speed - expected_v, seen_w - expected_w
    if doubted:
        # the speed counts for nothing, it goes on as a car's does; the turn may still be of use
        rejected = 1
        counts = counts._replace(odometry_doubted=counts.odometry_doubted + 1)
        if not turn_doubted:
            rw = (_DOUBTED_RADPS + _DOUBTED_SHARE * abs(rate)) ** 2
            mean, upper = update_by_two(mean, upper, _MOVING_RATE, rate - mean[4] - mean[6], rw)
    elif turn_doubted:
        # a turn that no car takes, or that never changes: of some use where there are fixes only
        rejected = 1
        counts = counts._replace(odometry_doubted=counts.odometry_doubted + 1)
        mean, upper = update_by_two(mean, upper, row_v, dv, rv)
        if stamp_s - state.held_s > _ALONE_AFTER_S:
            rw = (_DOUBTED_RADPS + _DOUBTED_SHARE * abs(rate)) ** 2
            mean, upper = update_by_two(mean, upper, _MOVING_RATE, rate - mean[4] - mean[6], rw)
    elif fails_gate(_pair_nis(upper, row_v, row_w, rv, rw, dv, dw), limit):
        rejected = state.odometry_rejected + 1
        counts = counts._replace(odometry_rejections=counts.odometry_rejections + 1)
        if rejected > REJECTIONS_MAX:
            # it insists: widen speed and yaw rate until it fits, then believe it
            rejected = 0
            upper = _widened(upper, dv * dv, dw * dw)
    if not rejected:
        mean, upper = update_by_two(mean, upper, row_v, dv, rv)
        predicted = mean[4] if standing else mean[4] + mean[6]
        mean, upper = update_by_two(mean, upper, row_w, seen_w - predicted, rw)
        if standing:
            # what is measured while nothing turns is the offset
            variance = config.yaw_rate_sd_radps**2
            mean, upper = update_by_two(
                mean, upper, _MOVING_RATE, rate - mean[4] - mean[6], variance
            )
    # the constructor, not _replace: this is the hot path
    return FilterState(
        stamp_s,
        mean,
        upper,
        counts,
        state.rival,
        state.last_pose_s,
        state.last_gnss_s,
        0 if doubted or turn_doubted else rejected,
        state.gnss_rejected_since_s,
        state.gnss_rejected,
        state.decision,
        state.nis,
        state.slip_rad_per_mps2,
        state.held_s,
        stamp_s,
        doubted or turn_doubted,
        still_since_s,
        state.odometry_prior,
        state.gnss_wrong,
        state.gnss_passed,
    )


def _offset_explains(mean: Mean, upper: Upper, rate: float) -> bool:
    """Whether the yaw rate is no more than its offset, to four standard deviations."""
    variance = upper[INDEX[_OFFSET][_OFFSET]] + _STILL_TURN_RADPS**2
    return (rate - mean[_OFFSET]) ** 2 <= 16.0 * variance


def _pair_nis(
    upper: Upper,
    one: tuple[int, float, int, float],
    two: tuple[int, float, int, float],
    variance_one: float,
    variance_two: float,
    residual_one: float,
    residual_two: float,
) -> float:
    """Squared Mahalanobis distance of two scalars with rows as in `update_by_two`."""
    i, a, j, b = one
    k, c, m, d = two
    row_i, row_j, row_k = INDEX[i], INDEX[j], INDEX[k]
    s00 = a * a * upper[row_i[i]] + 2.0 * a * b * upper[row_i[j]] + b * b * upper[row_j[j]]
    s11 = c * c * upper[row_k[k]] + 2.0 * c * d * upper[row_k[m]] + d * d * upper[INDEX[m][m]]
    s01 = a * (c * upper[row_i[k]] + d * upper[row_i[m]])
    s01 += b * (c * upper[row_j[k]] + d * upper[row_j[m]])
    s00, s11 = s00 + variance_one, s11 + variance_two
    cross = residual_one * residual_one * s11 + residual_two * residual_two * s00
    return (cross - 2.0 * residual_one * residual_two * s01) / (s00 * s11 - s01 * s01)


def _widened(upper: Upper, speed_m2ps2: float, rate_rad2ps2: float) -> Upper:
    values = list(upper)
    values[INDEX[_SPEED][_SPEED]] += speed_m2ps2
    values[INDEX[_RATE][_RATE]] += rate_rad2ps2
    return tuple(values)
