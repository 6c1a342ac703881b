"""``roll-guarded``: angle, rate and the bias of the angular acceleration as states, guarded against bad samples.

The filters of Asghari et al. 2018 fail (docs/roll.md) on a bias of the tangential accelerometer, glitches at the start,
zeros, a stuck sensor and lost samples. States x = (angle, rate, bias b), input u = omega', observation y = omega^2::

    angle' = angle + T rate + T^2/2 (u - b)     rate' = rate + T (u - b)     b' = b

The update corrects the angle too, by its covariance with the rate, so the noise of u that it removes from the rate is
removed from the angle; integrating the filtered rate would leave it there. An observation beyond ``gate_sd`` standard
deviations is left out, and so is an angular acceleration that far from the median of the last five. The variance R is
widened by alpha as in (16), (17), up to a cap that keeps the filter from diverging. After ``lockout`` refused
observations in a row the rate restarts at the median of the last nine, in the sense that it had where it had one.
Values that repeat to the last bit come from a stuck sensor and count as missing.
"""

from dataclasses import dataclass
from math import nan, sqrt
from typing import NamedTuple

from stillpoint.datasets.compiled import compiled, like
from stillpoint.datasets.recording import SpinGeometry
from stillpoint.datasets.settings import number
from stillpoint.filters.spin.guard import (
    ACCELS,
    Accels,
    Refusals,
    Repeats,
    Window,
    add_innovation,
    add_refusal,
    check_jump,
    clear_guards,
    drop_stuck,
    end_lockout,
    end_refusals,
    median_of_refused,
    start_accels,
    start_refusals,
    start_repeats,
    start_window,
)
from stillpoint.filters.spin.noise import Noise, SpinParams, observation_noise
from stillpoint.filters.spin.rate import MEDIAN_OF, Counts, count_restart, count_sample, set_sense, start_counts
from stillpoint.filters.spin.sample import (
    SpinMotion,
    SpinOutput,
    SpinSample,
    start_motion,
    wrap_angle,
)
from stillpoint.filters.spin.start import (
    MEDIAN_VAR,
    Start,
    add_first_sample,
    empty_start,
    forget_rates,
    is_sound,
    rate_size,
    rate_variance,
    restart,
)

_SENSE_SQUARE = 3.0**2  # a rate has a sense where it is so many standard deviations from 0
_HELD_S = 0.1  # an angular acceleration stands for no longer than that


@dataclass(frozen=True)
class Params(SpinParams):
    """Parameters of ``roll-guarded``."""

    window: float = number(5, 2, 100, "number of innovations that are averaged for alpha")
    least_alpha: float = number(
        3, 1, 100, "alpha counts from here on; five squares of matched noise reach 3 once in 100"
    )
    largest_alpha: float = number(10, 1, 1e6, "largest factor on the variance of the observation")
    gate_sd: float = number(5, 2, 100, "a sample beyond this many standard deviations is left out")
    lockout: float = number(25, 9, 1e6, "number left out in a row after which the filter starts again from them")
    stuck: float = number(8, 3, 1e6, "a value that comes this many times in a row counts as missing")
    bias_sd_radps2: float = number(1.0, 0.0, 1e3, "bias of the angular acceleration at the start, rad/s^2")
    bias_drift_radps2_rts: float = number(1e-3, 0.0, 10.0, "random walk of that bias, rad/s^2 per root second")
    unknown_accel_radps2: float = number(5.0, 0.1, 1e4, "sd of an angular acceleration that is missing")


class Coefficients(NamedTuple):
    """Constants derived once from the parameters."""

    noise: Noise
    window: int
    least_alpha: float
    largest_alpha: float
    gate: float  # square of the number of standard deviations
    accel_gate_var: float  # of an angular acceleration less the median of the last
    lockout: int
    stuck: int
    bias_var: float
    drift_var: float  # per second
    unknown_var: float  # of an angular acceleration that is missing


class Bias(NamedTuple):
    """The bias of the angular acceleration, with its part of the covariance."""

    accel_radps2: float
    angle_cov: float
    rate_cov: float
    var: float


class Drive(NamedTuple):
    """The angular acceleration that drives the next interval."""

    accel_radps2: float
    var: float
    is_measured: bool  # False: nothing is known, also nothing of its bias


class State(NamedTuple):
    """The state of the filter between two samples."""

    start: Start
    motion: SpinMotion
    bias: Bias
    push: Drive
    window: Window
    refusals: Refusals
    accels: Accels
    repeats: Repeats
    tally: Counts


def coefficients(params: Params, geometry: SpinGeometry) -> Coefficients:
    """Precompute the filter's constants from its parameters and the sensors' geometry."""
    of = observation_noise(params, geometry)
    gate = params.gate_sd**2
    return Coefficients(
        noise=of,
        window=round(params.window),
        least_alpha=params.least_alpha,
        largest_alpha=params.largest_alpha,
        gate=gate,
        accel_gate_var=gate * of.accel_var * (1.0 + MEDIAN_VAR / ACCELS),
        lockout=round(params.lockout),
        stuck=round(params.stuck),
        bias_var=params.bias_sd_radps2**2,
        drift_var=params.bias_drift_radps2_rts**2,
        unknown_var=params.unknown_accel_radps2**2,
    )


@compiled
def start(c: Coefficients) -> State:
    """Return the state before the first sample."""
    bias, push = Bias(0.0, 0.0, 0.0, c.bias_var), Drive(0.0, 0.0, False)
    guards = start_window(c.window, 0.0), start_refusals(0.0), start_accels(0.0), start_repeats(0.0)
    return State(empty_start(MEDIAN_OF, 0.0), start_motion(0.0), bias, push, *guards, start_counts())


@compiled
def predict_state(
    motion: SpinMotion, bias: Bias, push: Drive, dt_s: float, drift_var: float
) -> tuple[SpinMotion, Bias]:
    """Predict angle, rate and bias over an interval."""
    t, half_s, bias_s = dt_s, 0.5 * dt_s, dt_s
    accel = push.accel_radps2 - bias.accel_radps2
    if not push.is_measured:
        accel, bias_s = 0.0, 0.0
    turns, rest = wrap_angle(motion.turns, motion.rest_rad + t * (motion.rate_radps + half_s * accel))
    # covariances: the angle takes half_s * bias_s of the bias, the rate bias_s of it
    of_angle = bias.angle_cov + t * bias.rate_cov - half_s * bias_s * bias.var
    of_rate = bias.rate_cov - bias_s * bias.var
    rate_var = motion.rate_var - bias_s * (bias.rate_cov + of_rate)
    cross_var = motion.cross_var + t * motion.rate_var - half_s * bias_s * bias.rate_cov - bias_s * of_angle
    angle_var = motion.angle_var + t * motion.cross_var - half_s * bias_s * bias.angle_cov
    angle_var += (
        t * (motion.cross_var + t * motion.rate_var - half_s * bias_s * bias.rate_cov) - half_s * bias_s * of_angle
    )
    step_var = t * t * push.var  # as of white noise within the interval: the end of a gap does not tell the way there
    moved_roll = SpinMotion(
        turns,
        rest,
        motion.rate_radps + t * accel,
        angle_var + t * t * (1 / 3) * step_var,
        cross_var + half_s * step_var,
        rate_var + step_var,
    )
    return moved_roll, Bias(bias.accel_radps2, of_angle, of_rate, bias.var + t * drift_var)


@compiled
def _remaining_variance(var: float, cov: float, share: float, left: float) -> float:
    """Return a variance after an update of the rate: the part the rate does not explain stays, of the rest ``left``.

    ``share`` is its covariance ``cov`` with the rate over that one's variance. Rounding cannot take it below 0.
    """
    explained = share * cov
    return max(var - explained, 0.0) + left * explained


@compiled
def correct_state(motion: SpinMotion, bias: Bias, residual: float, noise_var: float) -> tuple[SpinMotion, Bias]:
    """Correct all states by an observation with its residual; H = (0, 2 rate, 0)."""
    h = motion.rate_radps + motion.rate_radps
    of_rate = h * motion.rate_var * h
    total = of_rate + noise_var
    along = h * residual / total
    left = noise_var / total  # 1 - K H
    of_angle, of_bias = motion.cross_var / motion.rate_var, bias.rate_cov / motion.rate_var
    turns, rest = wrap_angle(motion.turns, motion.rest_rad + motion.cross_var * along)
    after = SpinMotion(
        turns,
        rest,
        motion.rate_radps + motion.rate_var * along,
        _remaining_variance(motion.angle_var, motion.cross_var, of_angle, left),
        motion.cross_var * left,
        motion.rate_var * left,
    )
    return after, Bias(
        bias.accel_radps2 + bias.rate_cov * along,
        bias.angle_cov - of_rate / total * of_angle * bias.rate_cov,
        bias.rate_cov * left,
        _remaining_variance(bias.var, bias.rate_cov, of_bias, left),
    )


@compiled
def _judge_observation(
    motion: SpinMotion, bias: Bias, window: Window, refusals: Refusals, sample: SpinSample, c: Coefficients
) -> tuple[SpinMotion, Bias, Window, Refusals, float]:
    """Judge an observation by its innovation, then use or refuse it; also return the normalised innovation."""
    rate = motion.rate_radps
    residual = sample.square_rad2ps2 - rate * rate
    square_var = c.noise.square_var * sample.square_widened
    expected = 4.0 * rate * rate * motion.rate_var + square_var
    window, alpha = add_innovation(window, residual, expected, c.least_alpha, c.largest_alpha)
    if residual * residual <= c.gate * alpha * expected:
        noise_var = (alpha - 1.0) * expected + square_var
        motion, bias = correct_state(motion, bias, residual, noise_var)
        refusals = end_refusals(refusals)
    else:
        refusals = add_refusal(refusals, rate_size(sample.square_rad2ps2), sample.dt_s)
    return motion, bias, window, refusals, residual / sqrt(expected)


@compiled
def _choose_drive(state: State, sample: SpinSample, c: Coefficients) -> tuple[Drive, Accels, float]:
    """Return the drive of the next interval by the sample's angular acceleration, and the rate to restore."""
    if not sample.has_accel:
        return Drive(0.0, c.unknown_var, False), state.accels, 0.0
    gate_var, scratch = c.accel_gate_var * sample.accel_widened, state.refusals.scratch_radps
    accels, accel, is_own, withheld_radps = check_jump(state.accels, sample, gate_var, scratch)
    return (
        Drive(accel, c.noise.accel_var * sample.accel_widened if is_own else c.unknown_var, True),
        accels,
        withheld_radps,
    )


@compiled
def _choose_sense(motion: SpinMotion, direction: int, c: Coefficients) -> int:
    """Return the sense, +1 or -1: a sensor's, else that of the rate where it has one, else the assumed one."""
    if direction != 0:
        return direction
    square = motion.rate_radps * motion.rate_radps
    least = max(_SENSE_SQUARE * motion.rate_var, sqrt(c.noise.square_var))  # below it the square shows none
    if square <= least:
        return c.noise.sense
    return 1 if motion.rate_radps > 0.0 else -1


@compiled
def _restart_rate(state: State, direction: int, c: Coefficients) -> State:
    """Restart the rate from the refused observations; the angle may have lost turns meanwhile, the bias is unknown."""
    motion = state.motion
    rate = median_of_refused(state.refusals) * like(0.0, _choose_sense(motion, direction, c))
    lasting_s = state.refusals.lasting_s
    if state.refusals.n_restarts == 0 and state.window.seen == state.refusals.in_row:
        lasting_s += state.start.elapsed_s  # none has passed yet: the start was wrong
    lost = (rate - motion.rate_radps) * lasting_s
    rate_var = rate_variance(rate, c.noise.square_var)
    motion = SpinMotion(motion.turns, motion.rest_rad, rate, motion.angle_var + lost * lost, 0.0, rate_var)
    bias = Bias(state.bias.accel_radps2, 0.0, 0.0, c.bias_var)
    guards = Window(state.window.squares, 0), end_lockout(state.refusals), state.accels, state.repeats
    return State(state.start, motion, bias, state.push, *guards, state.tally)


@compiled
def _add_unseen_motion(begun: Start, motion: SpinMotion, accel_var: float) -> tuple[Start, SpinMotion]:
    """Add to the angle's variance an unmeasured angular acceleration over the time without any value."""
    way = 0.5 * begun.elapsed_s * begun.elapsed_s
    var = way * way * accel_var
    rates, held, gained, gained_rad, elapsed_s, turns, rest, angle_var = begun
    begun = Start(rates, held, gained, gained_rad, elapsed_s, turns, rest, angle_var + var)
    return begun, SpinMotion(
        motion.turns, motion.rest_rad, motion.rate_radps, motion.angle_var + var, motion.cross_var, motion.rate_var
    )


@compiled
def _begin_state(state: State, sample: SpinSample, repeats: Repeats, c: Coefficients) -> tuple[State, SpinOutput]:
    """Use one of the first samples to find the rate to start from."""
    sense = c.noise.sense if sample.direction == 0 else sample.direction
    square_var = c.noise.square_var * sample.square_widened
    was_stuck = state.repeats.same_squares >= c.stuck and repeats.same_squares < c.stuck
    before = state.start
    if was_stuck:  # by the sensors' first values nothing is known, nor is their angular acceleration the usual one
        both = state.repeats.same_accels >= c.stuck
        before = forget_rates(before, both)
        if both:
            state = State(
                before,
                state.motion,
                state.bias,
                state.push,
                *clear_guards(state.window, state.refusals, state.accels),
                repeats,
                state.tally,
            )
    begun, motion = add_first_sample(before, sample, state.push.accel_radps2, sense, square_var)
    if before.held == 0 and begun.held == 1 and not state.push.is_measured:
        begun, motion = _add_unseen_motion(begun, motion, c.unknown_var)
    push, accels, _ = _choose_drive(state, sample, c)
    guards = state.window, state.refusals, accels, repeats
    state = State(begun, motion, state.bias, push, *guards, count_sample(state.tally, sample, False))
    return state, SpinOutput(motion, nan, begun.held == MEDIAN_OF)


@compiled
def _restart_state(state: State, sample: SpinSample, repeats: Repeats, c: Coefficients) -> tuple[State, SpinOutput]:
    """Restart after an impossible state: from the angle before, with the sample as the first one."""
    bias, push = Bias(0.0, 0.0, 0.0, c.bias_var), Drive(0.0, 0.0, False)
    guards = clear_guards(state.window, state.refusals, state.accels)
    state = State(
        restart(state.start, state.motion), state.motion, bias, push, *guards, repeats, count_restart(state.tally)
    )
    return _begin_state(state, sample, repeats, c)


@compiled
def step(state: State, sample: SpinSample, c: Coefficients) -> tuple[State, SpinOutput]:
    """Predict, judge the observation, then use it, refuse it, or restart."""
    sample, repeats = drop_stuck(sample, state.repeats, c.stuck)
    if state.start.held < MEDIAN_OF:
        return _begin_state(state, sample, repeats, c)
    window, refusals, innovation = state.window, state.refusals, nan
    driving = state.push
    if sample.dt_s > _HELD_S:
        driving = Drive(0.0, c.unknown_var, False)
    motion, bias = predict_state(state.motion, state.bias, driving, sample.dt_s, c.drift_var)
    push, accels, withheld_radps = _choose_drive(state, sample, c)
    motion = SpinMotion(
        motion.turns,
        motion.rest_rad,
        motion.rate_radps + withheld_radps,
        motion.angle_var,
        motion.cross_var,
        motion.rate_var,
    )
    if sample.has_square:
        motion, bias, window, refusals, innovation = _judge_observation(motion, bias, window, refusals, sample, c)
    if not is_sound(motion):
        return _restart_state(state, sample, repeats, c)
    motion, is_turned_over = set_sense(motion, sample.direction)
    if is_turned_over:
        bias = Bias(bias.accel_radps2, bias.angle_cov, -bias.rate_cov, bias.var)
    tally = count_sample(state.tally, sample, is_turned_over)
    state = State(state.start, motion, bias, push, window, refusals, accels, repeats, tally)
    if refusals.in_row >= c.lockout:
        state = _restart_rate(state, sample.direction, c)
    return state, SpinOutput(state.motion, innovation, True)
