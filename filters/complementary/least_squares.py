r"""``cf-lse`` and ``cf-lse-literal``: the filter of eq (10) with gains by least squares (Zia 2022, eqs (14)-(22)).

The filter is that of ``fixed_gain``, whose docstring has its equations. After the first 50 samples the paper computes
the gains K = (kp, kI) anew at each sample, from all samples so far, as the least-squares solution of ::

    S = H K        S = x' - x_g'        H = [e,  integral(e)]        e = x_a - x                        (21)
    K = (H^T H)^-1 H^T S                                                                                (22)

**Eq (22) as printed returns the gains that were in use** (``cf-lse-literal``). Proof: (10), differentiated, *is*
x' - x_g' = kp e + kI integral(e), so S = H K0 holds exactly, with the K0 that the filter ran with. Hence
K = (H^T H)^-1 H^T H K0 = K0 for every record for which H^T H can be inverted: the data cancel. A test holds the gains
to 1e-6 of the fixed ones over a whole mission; what is left is rounding. The paper's figures 10 and 11 show gains that
move, so its program computes something else than its eq (22); the text does not say what.

**The cost function (14) does not help.** The sum of (x_a - x)^2 is smallest for kp -> infinity, where x = x_a: it
rewards following the accelerometer with all its noise. With S = x_a' - x_g', another reading, the regression is on a
differentiated noise, unstable without bounds and at the lower one with them.

**The well-posed reading** (``cf-lse``): K is chosen so that the filter's *next* prediction meets the *next*
measurement. Over one step the filter adds T H_k K to what the gyro says, and what it should have added is ::

    S_k T  =  x_a(k+1) - x(k) - T x_g'  =  (what was added)  +  e_(k+1)                 (one-step prediction)

Eq (22) is then an ordinary least-squares fit, here with exponential forgetting (``memory_s``) and bounds: kp within its
own, kI between its lower one and kp^2/4, beyond which the error would oscillate. Roll, pitch and heading have a
regression and gains of their own. Forgetting, bounds, and whether the gains are common, the paper does not give; "50
iterations" of its text are "50 seconds" in figures 10 and 11, here ``fixed_samples`` = 50.

**What it converges to.** K stays where it is when e_(k+1) is uncorrelated with e_k and its integral. The innovations of
an optimal filter are so: for a gyro and an accelerometer with white noise alone, kp T converges to the steady gain of
the Kalman filter, which a test compares with the closed form. It is known to 1/sqrt(samples in memory) only: with the
default memory at 50 Hz, kp is uncertain by 0.5 1/s, more than most good gains are.

**Fails: the gains follow the waves.** For any other error the regression takes for signal whatever predicts the next
sample of x_a. Waves accelerate the vehicle over seconds, so the error that they make in x_a at one sample is there at
the next: following it predicts well, and kp rises (unbounded to 3-11 1/s; here to ``kp_high_per_s``). That is the
opposite of what was wanted, in the very phase, on the surface, for which the gains were to adapt: on the simulated
mission the roll is then 1.2 deg off (rms), as the accelerometer's own is, against 0.1-0.3 deg with kp = 0.1-0.3 fixed.
In a calm sea the roll differs from the *measured* one as in the paper's table 1 (0.0045 deg^2; here 0.0035, the noise
of the accelerometer). That table takes the measured angle for the truth and so rewards the same following. A magnetic
disturbance that one drives past raises the gain of the heading alike. What can be done is to bound kp: with
``kp_high_per_s`` = 0.3 the result is that of the fixed gain.

**Angles.** As in ``fixed_gain``, e is a rotation. Its parts are taken about the direction of travel (the horizontal
part of the body's x axis: roll), across it (pitch) and about the vertical (heading), so that nothing wraps. Where the
body's x axis is vertical, roll and heading are one, and the parts are taken about east and north instead: a gain may
then weigh another part, the error remains the whole rotation. Each part has its own clock, that of its sensor. As the
integral stands in H itself, the bias removed is kI times it, and a jump of kI is a jump of the bias: (10) at its word.
"""

from dataclasses import dataclass
from math import exp, sqrt
from typing import NamedTuple

from stillpoint.datasets.compiled import compiled_entry, compiled_inside
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.settings import Settings, number
from stillpoint.filters import rotation
from stillpoint.filters.complementary.fixed_gain import Error, correction_gains, measure_error, settling_time_s
from stillpoint.filters.complementary.pi_observer import (
    Observer,
    begin_observer,
    keep_prediction,
    make_output,
    predict_observer,
    set_attitude,
    start_observer,
)
from stillpoint.filters.fields import smooth_fields
from stillpoint.filters.rotation import Quaternion, Vector, conjugate, multiply, rotate
from stillpoint.filters.sample import GAP_S, Floats, Log, Output, Sample, read_sample

# 1 - (correlation of error and integral)^2 below which both gains together explain the samples, but neither alone.
_LEAST_INDEPENDENT = 1e-5


class Regression(NamedTuple):
    """How the gains are fitted; derived once from the parameters."""

    fixed_samples: int  # before the first fit
    memory_s: float
    kp_low_per_s: float
    kp_high_per_s: float
    ki_low_per_s2: float
    as_printed: bool  # S is what was added, and there are no bounds; else what should have been added


class Fit(NamedTuple):
    """The sums that make H^T H and H^T S of (22), with exponential forgetting, and the solution."""

    ee: float  # (rad s)^2; e for the error, i for its integral, s for S, each times T
    ei: float  # rad^2 s^3
    ii: float  # rad^2 s^4
    es: float  # rad^2 s
    si: float  # rad^2 s^2
    samples: int
    kp_per_s: float
    ki_per_s2: float
    clipped: int  # fits beyond the bounds
    undetermined: int  # samples that keep the gains: error and integral are proportional


class Part(NamedTuple):
    """One of roll, pitch and heading, between two samples of its sensor."""

    fit: Fit
    error_rad_s: float  # e T of the last sample: the first column of H, times T
    integral_rad_s: float  # the second column of H
    turned_rad: float  # by kp, at the last sample
    ki_per_s2: float  # in use


@compiled_inside
def _start_part(kp_per_s: float, ki_per_s2: float) -> Part:
    """Return a part before the first sample, with these gains."""
    return Part(Fit(0.0, 0.0, 0.0, 0.0, 0.0, 0, kp_per_s, ki_per_s2, 0, 0), 0.0, 0.0, 0.0, ki_per_s2)


@compiled_inside
def _add_row(fit: Fit, error: float, integral: float, added: float, dt_s: float, c: Regression) -> Fit:
    """Add one row of H and S (times T) to the sums and solve eq (22)."""
    ee, ei, ii, es, si, samples, kp, ki, clipped, undetermined = fit
    fade = exp(-dt_s / c.memory_s)
    ee, ei, ii = ee * fade + error * error, ei * fade + error * integral, ii * fade + integral * integral
    es, si = es * fade + error * added, si * fade + integral * added
    samples += 1
    if samples >= c.fixed_samples:
        determinant = ee * ii - ei * ei
        if determinant > _LEAST_INDEPENDENT * ee * ii:
            kp, ki = (ii * es - ei * si) / determinant, (ee * si - ei * es) / determinant
            if not c.as_printed:
                best_kp, best_ki = kp, ki
                kp = min(max(kp, c.kp_low_per_s), c.kp_high_per_s)
                ki = min(max(ki, c.ki_low_per_s2), kp * kp * 0.25)
                clipped += 1 if kp != best_kp or ki != best_ki else 0
        else:
            undetermined += 1
    return Fit(ee, ei, ii, es, si, samples, kp, ki, clipped, undetermined)


@compiled_inside
def _update_part(part: Part, error: float, integral: float, dt_s: float, follows: bool, c: Regression) -> Part:
    """Fit the gains to what the last correction left over, then compute the next correction.

    ``integral`` is this part's before this error; ``follows`` is False where the sample before is too old for a row.
    """
    fit = part.fit
    if follows:
        added = part.turned_rad + part.ki_per_s2 * part.integral_rad_s * dt_s
        should = added if c.as_printed else added + error
        fit = _add_row(fit, part.error_rad_s, part.integral_rad_s * dt_s, should, dt_s, c)
    turned, biased = correction_gains(fit.kp_per_s, fit.ki_per_s2, dt_s)
    return Part(fit, error * dt_s, integral + error * dt_s, error * turned, biased / dt_s)


@compiled_inside
def _interrupt_part(part: Part) -> Part:
    """Return a part after a gap: the sums stay, but no correction precedes the next row."""
    return Part(part.fit, 0.0, part.integral_rad_s, 0.0, part.ki_per_s2)


# The horizontal part of the body's x axis, squared, below which there is no direction of travel.
_LEAST_FORWARD = 1e-6


@dataclass(frozen=True)
class Params(Settings):
    """Parameters of ``cf-lse``."""

    kp_per_s: float = number(1.0, 0.0, 10.0, "proportional gain kp of (10) until the first fit, 1/s")
    ki_per_s2: float = number(0.05, 0.0, 25.0, "integral gain kI of (10) until the first fit, 1/s^2")
    fixed_samples: float = number(50.0, 2.0, 1e6, "how many samples of a sensor come before the first fit")
    memory_s: float = number(200.0, 1.0, 1e6, "time constant of forgetting in the fit, s")
    kp_low_per_s: float = number(0.01, 0.0, 10.0, "lower bound of kp, 1/s")
    kp_high_per_s: float = number(5.0, 0.01, 50.0, "upper bound of kp, 1/s")
    ki_low_per_s2: float = number(1e-5, 0.0, 1.0, "lower bound of kI, 1/s^2; the upper one is kp^2/4")


@dataclass(frozen=True)
class LiteralParams(Settings):
    """Parameters of ``cf-lse-literal``."""

    kp_per_s: float = number(1.0, 0.0, 10.0, "proportional gain kp of (10), 1/s: (22) returns it")
    ki_per_s2: float = number(0.05, 0.0, 25.0, "integral gain kI of (10), 1/s^2: (22) returns it")
    fixed_samples: float = number(50.0, 2.0, 1e6, "how many samples of a sensor come before the first fit")
    memory_s: float = number(1e6, 1.0, 1e6, "time constant of forgetting in the fit, s")


class Coefficients(NamedTuple):
    """Constants derived once from the parameters."""

    kp_per_s: float
    ki_per_s2: float
    regression: Regression  # of the gains after the first samples
    settling_s: float
    declination_rad: float  # east of true north


class Parts(NamedTuple):
    """The three angles, each with its own gains."""

    roll: Part
    pitch: Part
    heading: Part


class State(NamedTuple):
    """The state of the filter between two samples."""

    observer: Observer  # its b is kI times the integral
    integral_b_rad_s: Vector  # of e in (10), in body axes
    parts: Parts
    n_clipped: int  # fits of any part beyond the bounds
    n_undetermined: int  # fits of any part that keep the gains


def coefficients(params: Params, declination_rad: float) -> Coefficients:
    """Precompute the constants of ``cf-lse`` from its parameters and the local declination (east of true north).

    Raises :class:`BadParameter` for bounds of kp the wrong way round.
    """
    low, high = params.kp_low_per_s, params.kp_high_per_s
    if low > high:
        raise BadParameter(f"cf-lse: kp_low_per_s = {low:g} is above kp_high_per_s = {high:g}; exchange them")
    regression = Regression(int(params.fixed_samples), params.memory_s, low, high, params.ki_low_per_s2, False)
    return Coefficients(
        params.kp_per_s, params.ki_per_s2, regression, settling_time_s(params.kp_per_s), declination_rad
    )


def literal_coefficients(params: LiteralParams, declination_rad: float) -> Coefficients:
    """Precompute the constants of ``cf-lse-literal``, which has no bounds."""
    regression = Regression(int(params.fixed_samples), params.memory_s, 0.0, 0.0, 0.0, True)
    return Coefficients(
        params.kp_per_s, params.ki_per_s2, regression, settling_time_s(params.kp_per_s), declination_rad
    )


@compiled_entry
def start(c: Coefficients) -> State:
    """Return the state before the first sample: level, with the body's x axis pointing north."""
    part = _start_part(c.kp_per_s, c.ki_per_s2)
    return State(start_observer(0.0), (0.0, 0.0, 0.0), Parts(part, part, part), 0, 0)


@compiled_inside
def _forward_direction(q_nb: Quaternion) -> tuple[float, float]:
    """Return the horizontal direction (east, north) of the body's x axis; east where that axis is vertical."""
    w, x, y, z = q_nb
    half_east, half_north = 1.0 * 0.5 - y * y - z * z, x * y + w * z
    flat = half_east * half_east + half_north * half_north
    if flat < _LEAST_FORWARD:
        return 1.0, 0.0
    size = 1.0 / sqrt(flat)
    return half_east * size, half_north * size


@compiled_inside
def _to_travel_axes(v_n: Vector, forward: tuple[float, float]) -> Vector:
    """Return a vector of n along the direction of travel, to its left, and up."""
    return v_n[0] * forward[0] + v_n[1] * forward[1], v_n[1] * forward[0] - v_n[0] * forward[1], v_n[2]


@compiled_inside
def _from_travel_axes(v: Vector, forward: tuple[float, float]) -> Vector:
    """Return the inverse of :func:`_to_travel_axes`."""
    return v[0] * forward[0] - v[1] * forward[1], v[0] * forward[1] + v[1] * forward[0], v[2]


@compiled_inside
def _correct_state(state: State, error: Error, follow_accel: bool, follow_mag: bool, c: Coefficients) -> State:
    """Correct the predicted state by (10), with the gains of (22).

    ``follow_...``: the sample of that sensor before is recent enough for a row of (21).
    """
    q_nb, is_headed, (roll, pitch, heading) = state.observer.q_nb, state.observer.is_headed, state.parts
    forward = _forward_direction(q_nb)
    e_roll, e_pitch, e_turn = _to_travel_axes((error.tilt_x, error.tilt_y, error.turn), forward)
    i_roll, i_pitch, i_turn = _to_travel_axes(rotate(q_nb, state.integral_b_rad_s), forward)
    roll_turn = pitch_turn = turn = 0.0
    if error.tilt_s > 0:
        roll = _update_part(roll, e_roll, i_roll, error.tilt_s, follow_accel, c.regression)
        pitch = _update_part(pitch, e_pitch, i_pitch, error.tilt_s, follow_accel, c.regression)
        i_roll, roll_turn = roll.integral_rad_s, roll.turned_rad
        i_pitch, pitch_turn = pitch.integral_rad_s, pitch.turned_rad
    if error.is_first:
        turn, is_headed = e_turn, True
        heading = Part(heading.fit, 0.0, i_turn, 0.0, heading.ki_per_s2)
    elif error.turn_s > 0:
        heading = _update_part(heading, e_turn, i_turn, error.turn_s, follow_mag, c.regression)
        i_turn, turn = heading.integral_rad_s, heading.turned_rad
    b = i_roll * roll.ki_per_s2, i_pitch * pitch.ki_per_s2, i_turn * heading.ki_per_s2
    q_bn, turned_n = conjugate(q_nb), _from_travel_axes((roll_turn, pitch_turn, turn), forward)
    b_radps, turned_nb = rotate(q_bn, _from_travel_axes(b, forward)), multiply(rotation.exp(turned_n), q_nb)
    return State(
        set_attitude(state.observer, turned_nb, b_radps, is_headed, error.n_no_north),
        rotate(q_bn, _from_travel_axes((i_roll, i_pitch, i_turn), forward)),
        Parts(roll, pitch, heading),
        roll.fit.clipped + pitch.fit.clipped + heading.fit.clipped,
        roll.fit.undetermined + pitch.fit.undetermined + heading.fit.undetermined,
    )


@compiled_inside
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """Predict by the rate and the bias, then turn towards the attitude of the fields: one step of (10)."""
    observer, integral, parts, n_clipped, n_undetermined = state
    accel_s, gap_s = observer.fields.since_accel_s + sample.dt_s, GAP_S
    fields, fresh = smooth_fields(observer.fields, sample, 1.0)
    observer = predict_observer(observer, fields, sample, c.settling_s)
    if not observer.is_level:
        observer = begin_observer(observer, fresh, c.declination_rad)
        if fresh.accel:
            parts = Parts(_interrupt_part(parts.roll), _interrupt_part(parts.pitch), _interrupt_part(parts.heading))
        state = State(observer, integral, parts, n_clipped, n_undetermined)
    else:
        observer = keep_prediction(observer)
        state = State(observer, integral, parts, n_clipped, n_undetermined)
        if fresh.accel or fresh.mag:
            error = measure_error(observer.q_nb, fields, fresh, accel_s, observer.is_headed, c.declination_rad)
            state = _correct_state(state, error, accel_s <= gap_s, fresh.mag_hold_s <= gap_s, c)
    return state, make_output(state.observer, c.settling_s)


@compiled_entry
def run_gains(log: Log, state: State, c: Coefficients, kp_per_s: Floats, ki_per_s2: Floats) -> State:
    """Run over every sample of a log and store the gains of roll, pitch and heading after it (N, 3)."""
    for k in range(len(log.dt_s)):
        state, _ = step(state, read_sample(log, k), c)
        for i, part in enumerate(state.parts):
            kp_per_s[k, i] = part.fit.kp_per_s
            ki_per_s2[k, i] = part.fit.ki_per_s2
    return state
