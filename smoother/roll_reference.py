"""From a recording with a spin stream to angle and rate with their accuracy: the steps in order."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Floats, Recording
from stillpoint.datasets.trajectory import RollReference
from stillpoint.smoother.roll_encoder import EncoderReadings, readings_of
from stillpoint.smoother.roll_graph import Accuracy, Prior, accuracy_of, eliminated, prior_of, step_of
from stillpoint.smoother.roll_params import RollGraphParams
from stillpoint.smoother.roll_rows import Chain, angles_of, chain_of, rates_of, residuals, roots_of_weights
from stillpoint.smoother.roll_samples import MEDIAN_TO_SD, samples_of
from stillpoint.smoother.roll_start import Harmonic, find_harmonic, start_rates
from stillpoint.smoother.roll_state import AMPLITUDE, CONSTANTS, OFFSET, RollState

ROUGH = 3  # iterations before gravity is looked for
ADAPTING = 6  # iterations, after which the noise is no longer fitted: it and the weights could chase each other
HALVINGS = 8  # of a step that makes the fit worse
GLITCH = 0.25  # of the weight that a sample without an error has: below it, it counts as a glitch


@dataclass(frozen=True, eq=False)
class RollSolution:
    """The optimum, and how it was found."""

    state: RollState
    sds: tuple[float, float]  # of a sample of the acceleration and of the squared rate, as the residuals show them
    steps_radps: tuple[float, ...]  # the change of the rates, RMS, per iteration


def roll_graph(recording: Recording, params: RollGraphParams) -> RollReference:
    """Angle and rate about the spin axis at every sample of the accelerometers.

    Where gravity shows at the spin frequency the angle is measured from it: at 0 the body's z axis points up, as far as
    the spin axis allows. With an encoder it is the encoder's. Otherwise it is 0 at the first sample, and drifts.
    Raises :class:`Unobservable`.
    """
    samples = samples_of(recording, params.noise)
    readings = None
    if params.encoder.use:
        if recording.encoder is None:
            raise Unobservable(f"{recording.name}: has no encoder; leave encoder.use off")
        readings = readings_of(recording.encoder, int(samples.t_ns[0]), params.encoder)
    chain = chain_of(samples, readings, int(params.block), params.calibration.step_s, params.noise)
    state = start_of(chain, readings)
    prior = prior_of(samples, None, readings is not None, float(angles_of(chain, state)[0]), params)
    rough = improved(chain, state, prior, recording.name, params, ROUGH)
    harmonic = None if params.harmonic.search == "off" else find_harmonic(chain, rough.state, params.harmonic)
    state = rough.state
    if harmonic is not None:
        state = with_harmonic(chain, state, harmonic, readings)
        prior = prior_of(samples, harmonic, readings is not None, float(angles_of(chain, state)[0]), params)
    solution = improved(chain, state, prior, recording.name, params, int(params.iterations))
    if not solution.steps_radps[-1] < params.rate_limit_radps:
        raise _no_optimum(recording.name, solution)
    linear = eliminated(chain, solution.state, prior, solution.sds, recording.name)
    accuracy = accuracy_of(chain, linear, recording.name)
    return RollReference(
        t_ns=samples.t_ns,
        angle_rad=angles_of(chain, solution.state),
        rate_radps=rates_of(chain, solution.state),
        angle_sd_rad=accuracy.angle_sd_rad,
        rate_sd_radps=accuracy.rate_sd_radps,
        method="roll-graph",
        name=recording.name,
        diagnostics=_diagnostics(chain, solution, accuracy, harmonic),
    )


def start_of(chain: Chain, readings: EncoderReadings | None) -> RollState:
    """Rates from the squared rate; the angle is 0 at the first sample, or the encoder's."""
    rates = start_rates(chain.samples, 1.0)
    state = RollState(0.0, rates, np.zeros((int(chain.constants_of[-1]) + 1, len(CONSTANTS))))
    first = -float(angles_of(chain, state)[0])
    if readings is not None:
        t_s = (chain.samples.t_ns - chain.samples.t_ns[0]) / 1e9
        first = float(np.median(readings.angle_rad - np.interp(readings.t_s, t_s, angles_of(chain, state))))
    return replace(state, start_angle_rad=first)


def with_harmonic(chain: Chain, state: RollState, harmonic: Harmonic, readings: EncoderReadings | None) -> RollState:
    """The state turned so that gravity's phase is 0 all along."""
    turned = np.diff(harmonic.phase_rad, prepend=harmonic.phase_rad[0]) / chain.step_s[:-1]
    rates = state.mean_rate_radps + np.append(turned, 0.0)
    constants = state.constants.copy()
    constants[:, AMPLITUDE] = harmonic.amplitude_mps2
    moved = RollState(state.start_angle_rad + float(harmonic.phase_rad[0]), rates, constants)
    if readings is not None:
        t_s = (chain.samples.t_ns - chain.samples.t_ns[0]) / 1e9
        constants[:, OFFSET] = np.median(readings.angle_rad - np.interp(readings.t_s, t_s, angles_of(chain, moved)))
    return moved


def improved(
    chain: Chain, state: RollState, prior: Prior, name: str, params: RollGraphParams, iterations: int
) -> RollSolution:
    """Gauss-Newton with a line search, the robust weights renewed in every iteration, until the limit or for so many.

    The noise of a channel is the larger of what the samples show and of what the fit leaves, unless it is given.
    Raises :class:`Unobservable`.
    """
    steps: list[float] = []
    sds = _sds(chain, state, params)
    while len(steps) < iterations and not (steps and steps[-1] < params.rate_limit_radps):
        if len(steps) < ADAPTING:
            sds = _sds(chain, state, params)
        roots = roots_of_weights(chain, *residuals(chain, state), sds)
        step = step_of(chain, eliminated(chain, state, prior, sds, name), len(state.constants))
        before, share = _cost(chain, state, roots, prior), 1.0
        for _ in range(HALVINGS):
            if _cost(chain, _plus(state, step, share), roots, prior) <= before * (1 + 1e-9):
                break
            share /= 2
        state = _plus(state, step, share)
        steps.append(share * float(np.sqrt(np.mean(step.mean_rate_radps**2))))
    return RollSolution(state, sds, tuple(steps))


def _no_optimum(name: str, solution: RollSolution) -> Unobservable:
    count, last_degps = len(solution.steps_radps), np.rad2deg(solution.steps_radps[-1])
    return Unobservable(
        f"{name}: no optimum in {count} iterations, the last changed the rate by {last_degps:.2g} deg/s; "
        "the accelerometers contradict each other: check lever arms, signs and axes of the geometry"
    )


def _sds(chain: Chain, state: RollState, params: RollGraphParams) -> tuple[float, float]:
    samples = chain.samples
    if params.noise.source == "given":
        return samples.accel_sd, samples.squared_sd
    accel, squared = residuals(chain, state)
    return (
        max(samples.accel_sd, MEDIAN_TO_SD * float(np.median(np.abs(accel[chain.accel_seen])))),
        max(samples.squared_sd, MEDIAN_TO_SD * float(np.median(np.abs(squared[chain.squared_valid])))),
    )


def _plus(state: RollState, step: RollState, share: float) -> RollState:
    return RollState(
        state.start_angle_rad + share * step.start_angle_rad,
        state.mean_rate_radps + share * step.mean_rate_radps,
        state.constants + share * step.constants,
    )


def _cost(chain: Chain, state: RollState, roots: tuple[Floats, Floats], prior: Prior) -> float:
    """Sum of squares with the weights of the step before; where it falls, so does the robust one (roots are of it)."""
    measured = sum(float(np.sum((root * left) ** 2)) for root, left in zip(roots, residuals(chain, state), strict=True))
    off = state.constants[0] - prior.mean
    return measured + float(off @ np.linalg.solve(prior.cov, off))


def _diagnostics(chain: Chain, solution: RollSolution, accuracy: Accuracy, harmonic: Harmonic | None) -> dict[str, Any]:
    samples, state = chain.samples, solution.state
    left = residuals(chain, state)
    accel_sd, squared_sd = solution.sds
    roots = roots_of_weights(chain, *left, solution.sds)
    n = len(samples)
    glitches_a = (roots[0] * accel_sd < GLITCH) & chain.accel_seen
    glitches_s = (roots[1] * squared_sd < GLITCH) & chain.squared_valid
    if harmonic is not None:
        zero = "gravity: at 0 the z axis points up"
    elif chain.readings is not None:
        zero = "the encoder's zero"
    else:
        zero = "0 at the first sample; it drifts, as nothing fixes it: the rate is a reference, the angle is not"
    return {
        "angle": zero,
        "iterations": len(solution.steps_radps),
        "squared_rate_sd_rad2ps2": squared_sd,
        "acceleration_sd_radps2": accel_sd,
        "n_squared_rate_missing": int(n - samples.squared_valid.sum()),
        "n_acceleration_missing": int(n - samples.accel_valid.sum()),
        "n_squared_rate_glitches": int(glitches_s.sum()),
        "n_acceleration_glitches": int(glitches_a.sum()),
        "gravity_significance_sd": None if harmonic is None else harmonic.significance,
        "constants": {
            name: [float(state.constants[0, k]), float(accuracy.constants_sd[k])] for k, name in enumerate(CONSTANTS)
        },
    }
