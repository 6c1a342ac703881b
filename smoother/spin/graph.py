"""From a recording with a spin stream to angle and rate with their accuracy: the steps in order."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.trajectory import RollReference
from stillpoint.smoother.spin.chain import LONG_STEP, Chain, angles_of, chain_of, rates_of
from stillpoint.smoother.spin.encoder import EncoderReadings, readings_of
from stillpoint.smoother.spin.factors import (
    Accuracy,
    Linear,
    Prior,
    accuracy_of,
    eliminated,
    holding,
    prior_of,
    require_connected_chain,
    untold,
)
from stillpoint.smoother.spin.once_per_turn import Line, find_line, followed
from stillpoint.smoother.spin.params import RollGraphParams
from stillpoint.smoother.spin.plausibility import GLITCH, require_agreement
from stillpoint.smoother.spin.rows import roots_of
from stillpoint.smoother.spin.samples import RollSamples, samples_of, sign_of
from stillpoint.smoother.spin.solve import RollSolution, improved, no_optimum
from stillpoint.smoother.spin.start import start_of, with_gravity, with_vibration
from stillpoint.smoother.spin.state import AMPLITUDE, CONSTANTS, COS_S, OFFSET
from stillpoint.smoother.spin.zero_rate import least_squared, require_spin, smooth_squared, too_slow

ROUGH = 3  # iterations before gravity is looked for
VIBRATION_ROUNDS = 2  # the rates before the first one follow the vibration, and so does the angle it is fitted along


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
    require_spin(samples, params.calibration, recording.name)
    known = sign_of(recording.spin, params.calibration) if recording.spin is not None else None
    sign = known or (1.0 if params.direction == "positive" else -1.0)
    try:
        found = _solved(samples, readings, sign, params, recording.name)
    except Unobservable as error:
        squared, least = smooth_squared(samples), least_squared(samples, params.calibration)
        raise too_slow(samples, squared, least, readings, recording.name) or error from error
    chain, solution, line = found.chain, found.solution, found.line
    least = least_squared(samples, params.calibration, line)
    slow = too_slow(samples, rates_of(chain, solution.at.state) ** 2, least, readings, recording.name)
    if slow is not None:
        raise slow
    least_radps = float(np.sqrt(least_squared(samples, params.calibration))) / 2
    require_agreement(chain, solution, found.prior, least_radps, recording.name)
    linear = _linear(chain, solution, found.prior, recording.name)
    accuracy = accuracy_of(chain, linear, recording.name)
    return RollReference(
        t_ns=samples.t_ns,
        angle_rad=angles_of(chain, solution.at.state),
        rate_radps=rates_of(chain, solution.at.state),
        angle_sd_rad=accuracy.angle_sd_rad,
        rate_sd_radps=accuracy.rate_sd_radps,
        method="roll-graph",
        name=recording.name,
        diagnostics={
            **_diagnostics(chain, solution, accuracy, line),
            "not_told": [name for name, one in zip(CONSTANTS[:AMPLITUDE], found.held, strict=False) if one],
            "direction": "as a sensor shows it" if known or readings else f"taken as {params.direction}",
        },
    )


@dataclass(frozen=True, eq=False)
class _Solved:
    """The optimum, and what it is the optimum of."""

    chain: Chain
    prior: Prior  # with nothing held
    held: NDArray[np.bool_]  # (11,) constants that the samples do not tell
    line: Line | None
    solution: RollSolution


def _solved(
    samples: RollSamples, readings: EncoderReadings | None, sign: float, params: RollGraphParams, name: str
) -> _Solved:
    chain = chain_of(samples, readings, int(params.block), params.calibration.step_s, params.noise)
    state = start_of(chain, readings, sign)
    require_connected_chain(chain, len(state.constants), name)
    prior = prior_of(samples, None, readings is not None, float(angles_of(chain, state)[0]), params)
    # Until the harmonic is found the fit's own residuals are the noise: beside a given one too much would be a glitch.
    loose = replace(params, noise=replace(params.noise, source="data"))
    rough = improved(chain, state, prior, name, loose, ROUGH)
    line = None if params.harmonic.search == "off" else find_line(chain, rough.at.state, params.harmonic)
    if line is not None and line.is_gravity:
        chain, state = with_gravity(chain, rough.at.state, line)
        prior = prior_of(samples, line, readings is not None, float(angles_of(chain, state)[0]), params)
        rough = improved(chain, state, prior, name, loose, ROUGH)
    if line is not None and line.is_vibration:
        for _ in range(VIBRATION_ROUNDS):
            line = followed(chain, rough.at.state, line, params.harmonic)
            chain, state = with_vibration(chain, rough.at.state, line)
            prior = prior_of(samples, line, readings is not None, float(angles_of(chain, state)[0]), params)
            rough = improved(chain, state, prior, name, loose, ROUGH)
    # A constant that the samples do not tell would follow their noise, and turn the angle by degrees: it is held, and
    # counts in the covariance all the same.
    held = untold(_linear(chain, rough, prior, name), prior, name)
    state = replace(rough.at.state, constants=np.where(held, prior.mean, rough.at.state.constants))
    solution = improved(chain, state, holding(prior, held), name, params, int(params.iterations))
    if not solution.steps_radps[-1] < params.rate_limit_radps:
        raise no_optimum(name, solution)
    return _Solved(chain, prior, held, line, solution)


def _linear(chain: Chain, solution: RollSolution, prior: Prior, name: str) -> Linear:
    return eliminated(chain, solution.at, roots_of(chain, solution.at, solution.sizes), prior, name)


def _diagnostics(chain: Chain, solution: RollSolution, accuracy: Accuracy, line: Line | None) -> dict[str, Any]:
    samples, sizes, n = chain.samples, solution.sizes, len(chain.samples)
    roots = roots_of(chain, solution.at, sizes)
    facts = {
        "angle": _zero(chain, line),
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
    if line is not None:
        facts |= _turning(line)
    if line is not None and line.is_gravity:
        facts |= _found(solution, accuracy, CONSTANTS[AMPLITUDE : AMPLITUDE + 1])
    if line is not None and line.is_vibration:
        facts |= _found(solution, accuracy, CONSTANTS[COS_S:])
    if chain.readings is not None and roots.encoder is not None:
        facts |= _found(solution, accuracy, CONSTANTS[OFFSET:COS_S])
        facts["encoder_resolution_rad"] = chain.readings.resolution_rad
        facts["encoder_sd_rad"] = sizes.encoder_rad
        facts["n_encoder_outside"] = chain.readings.outside
        facts["n_encoder_glitches"] = int((roots.encoder * sizes.encoder_rad < GLITCH).sum())
    return facts


def _turning(line: Line) -> dict[str, Any]:
    """What turns with the shaft, and gravity as each channel shows it by itself."""
    return {
        "once_per_turn": line.verdict,
        "once_per_turn_why": line.why,
        "once_per_turn_significance_sd": line.significance,
        "gravity_by_squared_mps2": line.by_squared_mps2,
        "gravity_by_accel_mps2": line.by_accel_mps2,
        "ripple_radps": line.ripple_radps,
    }


def _zero(chain: Chain, line: Line | None) -> str:
    if line is not None and line.is_gravity:
        return "from gravity: 0 where the z axis points up most"
    if chain.readings is not None:
        return "the encoder's"
    drifts = "from 0 at the first sample; nothing fixes it after: the rate is a reference, the angle drifts"
    if line is not None and line.is_vibration:
        return f"{drifts}; once per turn there is something that was not taken for gravity: see once_per_turn_why"
    return drifts


def _found(solution: RollSolution, accuracy: Accuracy, names: Sequence[str]) -> dict[str, list[float]]:
    """Value and sd of constants, in their first step."""
    value, sd = solution.at.state.constants[0], accuracy.constants_sd
    return {name: [float(value[k]), float(sd[k])] for k, name in enumerate(CONSTANTS) if name in names}
