"""The memory by which ``roll-guarded`` recognises bad samples: innovations, refusals, jumps, repetitions."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled, like
from stillpoint.filters.spin.rate import MEDIAN_OF
from stillpoint.filters.spin.sample import SpinSample
from stillpoint.filters.spin.start import insert_sorted, median_sorted

ACCELS = 5  # samples whose median is the usual angular acceleration
_CLIPPED_AT = 9.0  # squares of innovations, in units of the widest variance: three standard deviations


class Window(NamedTuple):
    """Squares of the last innovations."""

    squares: NDArray[np.float64]  # (M,) a ring that is handed on and written in place
    seen: int


class Refusals(NamedTuple):
    """Observations that were left out, the last ones in a row."""

    rates_radps: NDArray[np.float64]  # (9,) sizes of the last rates, a ring that is handed on and written in place
    scratch_radps: NDArray[np.float64]  # (9,) to sort in
    in_row: int
    lasting_s: float
    n_refused: int
    n_restarts: int


class Accels(NamedTuple):
    """The last angular accelerations, to distinguish a glitch from a jump."""

    values_radps2: NDArray[np.float64]  # (5,) a ring that is handed on and written in place
    seen: int
    left_out_radps2: float  # the last one that was
    in_row: int
    withheld_radps: float  # what those in a row would have added to the rate
    n_accel_refused: int


class Repeats(NamedTuple):
    """The last values, and how often each came in a row."""

    square_rad2ps2: float
    same_squares: int
    accel_radps2: float
    same_accels: int
    n_stuck: int  # samples with a value that came too often


@compiled
def start_window(room: int, zero: float) -> Window:
    """Return the window before the first innovation."""
    return Window(np.full(room, zero), 0)


@compiled
def add_innovation(window: Window, residual: float, expected: float, least: float, most: float) -> tuple[Window, float]:
    """Add an innovation to the window; return alpha by (16), (17): 1 below ``least``, and at most ``most``.

    Squares are clipped, so that a single glitch does not open the gate for what follows it. Until the window is full
    alpha is of as many innovations as there are.
    """
    squares, seen = window
    room = len(squares)
    squares[seen % room] = min(residual * residual, _CLIPPED_AT * most * expected)
    held = min(seen + 1, room)
    total = 0.0
    for k in range(held):
        total += squares[k]
    alpha = total / (like(expected, held) * expected)
    return Window(squares, seen + 1), min(alpha, most) if alpha > least else 1.0


@compiled
def start_refusals(zero: float) -> Refusals:
    """Return the record without refusals."""
    return Refusals(np.full(MEDIAN_OF, zero), np.full(MEDIAN_OF, zero), 0, zero, 0, 0)


@compiled
def clear_guards(window: Window, refusals: Refusals, accels: Accels) -> tuple[Window, Refusals, Accels]:
    """Return the guards of a filter that restarts; the counts stay."""
    after = Accels(accels.values_radps2, 0, 0.0, 0, 0.0, accels.n_accel_refused)
    return Window(window.squares, 0), end_refusals(refusals), after


@compiled
def end_refusals(before: Refusals) -> Refusals:
    """Return the record after an observation that was used."""
    arrays = before.rates_radps, before.scratch_radps
    return Refusals(*arrays, 0, 0.0, before.n_refused, before.n_restarts)


@compiled
def add_refusal(before: Refusals, rate_radps: float, dt_s: float) -> Refusals:
    """Add an observation that was left out; its rate is kept, in case it is right."""
    rates, scratch, in_row, lasting_s, n_refused, n_restarts = before
    rates[in_row % MEDIAN_OF] = rate_radps
    return Refusals(rates, scratch, in_row + 1, lasting_s + dt_s, n_refused + 1, n_restarts)


@compiled
def end_lockout(before: Refusals) -> Refusals:
    """Return the record after a restart from the refused observations."""
    arrays = before.rates_radps, before.scratch_radps
    return Refusals(*arrays, 0, 0.0, before.n_refused, before.n_restarts + 1)


@compiled
def median_of_refused(refusals: Refusals) -> float:
    """Return the median of the rates that were refused last."""
    for k in range(MEDIAN_OF):
        insert_sorted(refusals.scratch_radps, k, refusals.rates_radps[k])
    return median_sorted(refusals.scratch_radps, MEDIAN_OF)


@compiled
def start_accels(zero: float) -> Accels:
    """Return the record before the first sample."""
    return Accels(np.full(ACCELS, zero), 0, zero, 0, zero, 0)


@compiled
def check_jump(
    before: Accels, sample: SpinSample, gate_var: float, scratch: NDArray[np.float64]
) -> tuple[Accels, float, bool, float]:
    """Return the angular acceleration to use, whether it is the sample's own, and the rate to restore.

    One whose square distance from the median of the last five exceeds ``gate_var`` is left out, and the median taken
    for it. A jump is a glitch where the next value is back, and true where it stays: then the rate that was left out is
    restored. ``scratch`` (5 or more,) is written over.
    """
    values, seen, left_out, in_row, withheld_radps, n_refused = before
    accel = sample.accel_radps2
    values[seen % ACCELS] = accel
    if seen + 1 < ACCELS:
        return Accels(values, seen + 1, left_out, 0, 0.0, n_refused), accel, True, 0.0
    for k in range(ACCELS):
        insert_sorted(scratch, k, values[k])
    usual = median_sorted(scratch, ACCELS)
    if (accel - usual) * (accel - usual) > gate_var:
        withheld_radps += sample.dt_s * (accel - usual)
        return Accels(values, seen + 1, accel, in_row + 1, withheld_radps, n_refused + 1), usual, False, 0.0
    stays = in_row > 0 and (accel - left_out) * (accel - left_out) <= gate_var
    return Accels(values, seen + 1, left_out, 0, 0.0, n_refused), accel, True, withheld_radps if stays else 0.0


@compiled
def start_repeats(zero: float) -> Repeats:
    """Return the record before the first sample."""
    return Repeats(zero, 0, zero, 0, 0)


@compiled
def drop_stuck(sample: SpinSample, before: Repeats, stuck: int) -> tuple[SpinSample, Repeats]:
    """Return the sample without values that came ``stuck`` times in a row or more."""
    square, accel = sample.square_rad2ps2, sample.accel_radps2
    squares = before.same_squares + 1 if square == before.square_rad2ps2 else 1
    accels = before.same_accels + 1 if accel == before.accel_radps2 else 1
    has_accel, has_square = sample.has_accel and accels < stuck, sample.has_square and squares < stuck
    n_stuck = before.n_stuck
    if has_accel != sample.has_accel or has_square != sample.has_square:
        n_stuck += 1
    kept = SpinSample(
        sample.dt_s,
        accel,
        square,
        sample.accel_widened,
        sample.square_widened,
        has_accel,
        has_square,
        sample.direction,
    )
    return kept, Repeats(square, squares, accel, accels, n_stuck)
