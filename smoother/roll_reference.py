"""From a recording with a spin stream to angle and rate with their accuracy: the steps in order."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.trajectory import RollReference
from stillpoint.smoother.roll_chain import LONG_STEP, Chain, angles_of, chain_of, rates_of
from stillpoint.smoother.roll_encoder import EncoderReadings, readings_of
from stillpoint.smoother.roll_graph import Accuracy, Linear, Prior, accuracy_of, eliminated, holding, prior_of, untold
from stillpoint.smoother.roll_optimum import RollSolution, improved, no_optimum
from stillpoint.smoother.roll_params import RollGraphParams
from stillpoint.smoother.roll_rows import roots_of
from stillpoint.smoother.roll_samples import samples_of, sign_of
from stillpoint.smoother.roll_start import Harmonic, find_harmonic, start_rates
from stillpoint.smoother.roll_state import AMPLITUDE, ARM_S, CONSTANTS, OFFSET, RollState

ROUGH = 3  # iterations before gravity is looked for
GLITCH = 0.25  # of the weight that a sample without an error has: below it, it counts as a glitch


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
        readings = readings_of(recording.encoder, samples.t_ns, params.encoder)
    chain = chain_of(samples, readings, int(params.block), params.calibration.step_s, params.noise)
    known = sign_of(recording.spin) if recording.spin is not None else None
    state = start_of(chain, readings, known or (1.0 if params.direction == "positive" else -1.0))
    prior = prior_of(samples, None, readings is not None, float(angles_of(chain, state)[0]), params)
    rough = improved(chain, state, prior, recording.name, params, ROUGH)
    harmonic = None
    if params.harmonic.search == "auto":
        harmonic = find_harmonic(chain, rough.at.state, params.harmonic)
    if harmonic is not None:
        state = with_harmonic(chain, rough.at.state, harmonic, readings)
        prior = prior_of(samples, harmonic, readings is not None, float(angles_of(chain, state)[0]), params)
        rough = improved(chain, state, prior, recording.name, params, ROUGH)
    # A constant that the samples do not tell would follow their noise, and turn the angle by degrees: it is held, and
    # counts in the covariance all the same.
    held = untold(_linear(chain, rough, prior, recording.name), prior)
    state = replace(rough.at.state, constants=np.where(held, prior.mean, rough.at.state.constants))
    solution = improved(chain, state, holding(prior, held), recording.name, params, int(params.iterations))
    if not solution.steps_radps[-1] < params.rate_limit_radps:
        raise no_optimum(recording.name, solution)
    accuracy = accuracy_of(chain, _linear(chain, solution, prior, recording.name), recording.name)
    return RollReference(
        t_ns=samples.t_ns,
        angle_rad=angles_of(chain, solution.at.state),
        rate_radps=rates_of(chain, solution.at.state),
        angle_sd_rad=accuracy.angle_sd_rad,
        rate_sd_radps=accuracy.rate_sd_radps,
        method="roll-graph",
        name=recording.name,
        diagnostics={
            **_diagnostics(chain, solution, accuracy, harmonic),
            "not_told": [name for name, one in zip(CONSTANTS[:AMPLITUDE], held, strict=False) if one],
            "direction": "as a sensor shows it" if known or readings else f"taken as {params.direction}",
        },
    )


def _linear(chain: Chain, solution: RollSolution, prior: Prior, name: str) -> Linear:
    return eliminated(chain, solution.at, roots_of(chain, solution.at, solution.sizes), prior, name)


def start_of(chain: Chain, readings: EncoderReadings | None, sign: float) -> RollState:
    """Rates from the squared rate; the angle is 0 at the first sample. With an encoder, its sign, scale and angle."""
    rates = start_rates(chain.samples, sign)
    constants = np.zeros((int(chain.constants_of[-1]) + 1, len(CONSTANTS)))
    if readings is None:
        return RollState(-float(rates[0] * chain.step_s[0]), rates, constants)
    scale = float(np.median(readings.rate_radps)) / float(np.median(rates[readings.k]))
    constants[:, ARM_S] = 1 / scale**2 - 1
    state = RollState(0.0, scale * rates, constants)
    first = float(np.median(readings.angle_rad - angles_of(chain, state)[readings.k]))
    return replace(state, start_angle_rad=first)


def with_harmonic(chain: Chain, state: RollState, harmonic: Harmonic, readings: EncoderReadings | None) -> RollState:
    """The state turned so that gravity's phase is 0 all along."""
    turned = np.diff(harmonic.phase_rad, prepend=harmonic.phase_rad[0]) / chain.step_s[:-1]
    rates = state.mean_rate_radps + np.append(turned, 0.0)
    constants = state.constants.copy()
    constants[:, AMPLITUDE] = harmonic.amplitude_mps2
    moved = RollState(state.start_angle_rad + float(harmonic.phase_rad[0]), rates, constants)
    if readings is not None:
        constants[:, OFFSET] = np.median(readings.angle_rad - angles_of(chain, moved)[readings.k])
    return moved


def _diagnostics(chain: Chain, solution: RollSolution, accuracy: Accuracy, harmonic: Harmonic | None) -> dict[str, Any]:
    samples, sizes, n = chain.samples, solution.sizes, len(chain.samples)
    roots = roots_of(chain, solution.at, sizes)
    facts = {
        "angle": _zero(chain, harmonic),
        "iterations": len(solution.steps_radps),
        "accel_sd_radps2": sizes.accel_radps2,
        "squared_sd_rad2ps2": sizes.squared_rad2ps2,
        "n_accel_missing": int(n - samples.accel_valid.sum()),
        "n_squared_missing": int(n - samples.squared_valid.sum()),
        "n_accel_glitches": int(((roots.accel * sizes.accel_radps2 < GLITCH) & chain.accel_seen).sum()),
        "n_squared_glitches": int(((roots.squared * sizes.squared_rad2ps2 < GLITCH) & chain.squared_valid).sum()),
        "n_gaps": int((chain.step_s > LONG_STEP * np.median(chain.step_s)).sum()),
        **_found(solution, accuracy, CONSTANTS[:AMPLITUDE]),
    }
    if harmonic is not None:
        facts |= _found(solution, accuracy, CONSTANTS[AMPLITUDE : AMPLITUDE + 1])
        facts["gravity_significance_sd"] = harmonic.significance
    if chain.readings is not None and roots.encoder is not None:
        facts |= _found(solution, accuracy, CONSTANTS[OFFSET:])
        facts["encoder_resolution_rad"] = chain.readings.resolution_rad
        facts["encoder_sd_rad"] = sizes.encoder_rad
        facts["n_encoder_outside"] = chain.readings.outside
        facts["n_encoder_glitches"] = int((roots.encoder * sizes.encoder_rad < GLITCH).sum())
    return facts


def _zero(chain: Chain, harmonic: Harmonic | None) -> str:
    if harmonic is not None:
        return "from gravity: 0 where the z axis points up most"
    if chain.readings is not None:
        return "the encoder's"
    return "from 0 at the first sample; nothing fixes it after: the rate is a reference, the angle drifts"


def _found(solution: RollSolution, accuracy: Accuracy, names: Sequence[str]) -> dict[str, list[float]]:
    """Value and sd of constants, in their first step."""
    value, sd = solution.at.state.constants[0], accuracy.constants_sd
    return {name: [float(value[k]), float(sd[k])] for k, name in enumerate(CONSTANTS) if name in names}
