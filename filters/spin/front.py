"""The stage between the sensors of a spin and every estimator: the two observations, and which of them are usable.

One compiled step serves a stream and the loop over a recording, so both give an estimator the same samples. The
arithmetic is that of :func:`stillpoint.datasets.spin.measure`, row by row and in double precision.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled, like
from stillpoint.datasets.recording import Floats, Times
from stillpoint.datasets.spin import SATURATED, Channel, SpinChannels
from stillpoint.filters.precision import Precision, to_precision
from stillpoint.filters.sample import GAP_S
from stillpoint.filters.spin.direction import Evidence, axial_weights, find_direction
from stillpoint.filters.spin.noise import SpinParams
from stillpoint.filters.spin.sample import SpinLog, SpinSample

_LARGEST = 1e7  # m/s^2, rad/s: no sensor gives that much; the squares of squares stay finite in float32
_LONGEST_S = 3600.0  # a step counts as no longer than that: what the rate was before a gap of hours says nothing


class Weights(NamedTuple):
    """A :class:`stillpoint.datasets.spin.Channel` by all accelerometers, then without each of them: 1 + k rows."""

    accel: Floats  # (1 + k, k)
    products: Floats  # (1 + k, 3)
    variance: Floats  # (1 + k,)
    is_there: NDArray[np.bool_]  # (1 + k,) whether such accelerometers fix it


class Coefficients(NamedTuple):
    """Constants of a geometry."""

    omega_dot: Weights
    omega_squared: Weights
    omega_xy: Weights  # all 0 where it is not seen
    omega_xz: Weights
    transverse: Floats  # (2, m)
    axial: Floats  # (m,)
    limits_mps2: Floats  # (k,) from here on a value is saturated; infinite where the range is not known
    skips_saturated: bool
    zero: float  # in the precision of the estimator


class State(NamedTuple):
    """The state of the filter between two samples."""

    t_ns: int  # of the last sample; -1 before the first
    evidence: Evidence
    n_out_of_order: int
    n_spin_gaps: int
    n_lost: int  # samples without a value of an accelerometer that is used
    n_saturated: int  # samples with one at its range
    n_spared: int  # samples with a channel by the other accelerometers, as one was lost or at its range


class Reading(NamedTuple):
    """A channel at one sample."""

    value: float
    widened: float  # its variance by that of all accelerometers together
    is_usable: bool  # as far as accelerometers go
    is_spared: bool
    is_lost: bool
    is_saturated: bool
    needs_gyro: bool


def coefficients(by: SpinChannels, params: SpinParams, precision: Precision) -> Coefficients:
    """Precompute the constants of a geometry for an estimator with these parameters in this precision."""
    limits = by.geometry.accel_range_mps2
    k = len(by.geometry.accel_r_b_m)
    return Coefficients(
        _weights(by.omega_dot, by.spare_dot),
        _weights(by.omega_squared, by.spare_squared),
        _weights(by.omega_xy, (None,) * k),
        _weights(by.omega_xz, (None,) * k),
        np.array(by.transverse),
        np.array(axial_weights(by)),
        np.full(k, np.inf) if limits is None else SATURATED * limits,
        params.saturated == "skip",
        to_precision(0.0, precision),
    )


def _weights(channel: Channel | None, spares: Sequence[Channel | None]) -> Weights:
    rows = [channel, *spares]
    return Weights(
        np.array([np.zeros(len(spares)) if row is None else row.accel for row in rows]),
        np.array([np.zeros(3) if row is None else row.products for row in rows]),
        np.array([0.0 if row is None else row.variance for row in rows]),
        np.array([row is not None for row in rows]),
    )


@compiled
def start() -> State:
    """Return the state before the first sample."""
    return State(-1, Evidence(0.0, 0.0), 0, 0, 0, 0, 0)


@compiled
def _replace_unusable(value: float, otherwise: float) -> float:
    """Return the value, or ``otherwise`` if it is not a number or no sensor gives it."""
    return value if abs(value) < _LARGEST else otherwise


@compiled
def _rate_about(weights: Floats, gyro_radps: Floats, k: int) -> float:
    """Return a rate by the gyros (N, m) of row ``k``; a lost one counts as 0."""
    total = 0.0
    for i in range(len(weights)):
        total += weights[i] * _replace_unusable(gyro_radps[k, i], 0.0)
    return total


@compiled
def _lacks_gyro(gyro_radps: Floats, k: int, c: Coefficients) -> bool:
    """Return whether a gyro that gives the rates about y and z is lost."""
    for i in range(c.transverse.shape[1]):
        if (c.transverse[0, i] != 0.0 or c.transverse[1, i] != 0.0) and not abs(gyro_radps[k, i]) < _LARGEST:
            return True
    return False


@compiled
def _count_unusable(weights: Floats, accel_mps2: Floats, k: int, c: Coefficients) -> tuple[int, int]:
    """Return how many accelerometers with a weight (k,) are lost or saturated in row ``k``, and the last of them."""
    count, last = 0, 0
    for i in range(len(weights)):
        size = abs(_replace_unusable(accel_mps2[k, i], np.nan))
        if weights[i] != 0.0 and (not size < _LARGEST or (c.skips_saturated and size >= c.limits_mps2[i])):
            count, last = count + 1, i
    return count, last


@compiled
def _read_channel(
    weights: Weights, accel_mps2: Floats, k: int, rate_y: float, rate_z: float, c: Coefficients
) -> Reading:
    """Return a channel by the accelerometers (N, k) of row ``k`` and the rates about y and z.

    Where one of the accelerometers may not be used and the others fix the channel, it is by them.
    """
    is_lost, is_saturated = False, False
    for i in range(len(weights.accel[0])):
        if weights.accel[0, i] != 0.0:
            value = _replace_unusable(accel_mps2[k, i], np.nan)
            is_lost |= not abs(value) < _LARGEST
            is_saturated |= abs(value) >= c.limits_mps2[i]
    row = 0
    missing, last = _count_unusable(weights.accel[0], accel_mps2, k, c)
    if missing == 1 and weights.is_there[1 + last]:
        row = 1 + last
        missing, last = _count_unusable(weights.accel[row], accel_mps2, k, c)
    total = 0.0
    for i in range(len(weights.accel[row])):
        if weights.accel[row, i] != 0.0:
            total += weights.accel[row, i] * _replace_unusable(accel_mps2[k, i], np.nan)
    of_yy, of_zz, of_yz = weights.products[row, 0], weights.products[row, 1], weights.products[row, 2]
    if of_yy != 0.0:
        total += of_yy * (rate_y * rate_y)
    if of_zz != 0.0:
        total += of_zz * (rate_z * rate_z)
    if of_yz != 0.0:
        total += of_yz * (rate_y * rate_z)
    needs_gyro = of_yy != 0.0 or of_zz != 0.0 or of_yz != 0.0
    widened = weights.variance[row] / weights.variance[0] if row > 0 else 1.0
    is_usable = missing == 0
    return Reading(total, widened, is_usable, is_usable and row > 0, is_lost, is_saturated, needs_gyro)


@compiled
def step(
    state: State, t_ns: int, accel_mps2: Floats, gyro_radps: Floats, k: int, c: Coefficients
) -> tuple[State, SpinSample, bool]:
    """Return the estimator's sample by row ``k`` of (N, k) and (N, m); False where time has not risen."""
    zero = c.zero
    if t_ns <= state.t_ns:
        late = state.n_out_of_order + 1
        kept = State(
            state.t_ns, state.evidence, late, state.n_spin_gaps, state.n_lost, state.n_saturated, state.n_spared
        )
        return kept, SpinSample(zero, zero, zero, zero, zero, False, False, 0), False
    dt_s = min((t_ns - state.t_ns) / 1e9, _LONGEST_S) if state.t_ns >= 0 else 0.0
    rate_y, rate_z = _rate_about(c.transverse[0], gyro_radps, k), _rate_about(c.transverse[1], gyro_radps, k)
    dot = _read_channel(c.omega_dot, accel_mps2, k, rate_y, rate_z, c)
    square = _read_channel(c.omega_squared, accel_mps2, k, rate_y, rate_z, c)
    shown, var = 0.0, 0.0
    for weights, rate in ((c.omega_xy, rate_y), (c.omega_xz, rate_z)):
        product = _read_channel(weights, accel_mps2, k, rate_y, rate_z, c)
        if not product.is_lost:
            shown, var = shown + product.value * rate, var + weights.variance[0] * rate * rate
    evidence, direction = find_direction(state.evidence, _rate_about(c.axial, gyro_radps, k), shown, var)
    no_gyro = _lacks_gyro(gyro_radps, k, c)
    sample = SpinSample(
        like(zero, dt_s),
        like(zero, dot.value),
        like(zero, square.value),
        like(zero, dot.widened),
        like(zero, square.widened),
        _is_usable(dot, no_gyro),
        _is_usable(square, no_gyro),
        direction,
    )
    after = State(
        t_ns,
        evidence,
        state.n_out_of_order,
        state.n_spin_gaps + (1 if dt_s > GAP_S else 0),
        state.n_lost + (1 if dot.is_lost or square.is_lost else 0),
        state.n_saturated + (1 if dot.is_saturated or square.is_saturated else 0),
        state.n_spared + (1 if dot.is_spared or square.is_spared else 0),
    )
    return after, sample, True


@compiled
def _is_usable(reading: Reading, no_gyro: bool) -> bool:
    """Return whether a channel may be used."""
    return reading.is_usable and not (reading.needs_gyro and no_gyro)


@compiled
def filter_log(
    t_ns: Times, accel_mps2: Floats, gyro_radps: Floats, state: State, c: Coefficients
) -> tuple[State, SpinLog]:
    """Run over every sample of a recording whose time rises; return what the estimator gets."""
    n, zero = len(t_ns), c.zero
    log = SpinLog(
        np.full(n, zero),
        np.full(n, zero),
        np.full(n, zero),
        np.full(n, zero),
        np.full(n, zero),
        np.full(n, False),
        np.full(n, False),
        np.zeros(n, dtype=np.int64),
    )
    for k in range(n):
        state, sample, _ = step(state, t_ns[k], accel_mps2, gyro_radps, k, c)
        log.dt_s[k], log.accel_radps2[k], log.square_rad2ps2[k] = (
            sample.dt_s,
            sample.accel_radps2,
            sample.square_rad2ps2,
        )
        log.accel_widened[k], log.square_widened[k] = sample.accel_widened, sample.square_widened
        log.has_accel[k], log.has_square[k] = sample.has_accel, sample.has_square
        log.direction[k] = sample.direction
    return state, log
