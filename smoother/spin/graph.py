"""``method="roll-graph"``: angle and rate of a spinning body from one factor graph over its accelerometers.

gather   acceleration and squared rate of every sample, encoder readings     samples.py, encoder.py, chain.py
solve    rough fit, what turns once per turn, optimum                        start.py, once_per_turn.py, solve.py
judge    is the spin fast enough, and do the channels agree?                 zero_rate.py, plausibility.py
report   angle, rate and their sd at every sample                            factors.py
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.trajectory import SpinReference
from stillpoint.smoother.spin.chain import LONG_STEP, Chain, build_chain, integrate_angles, interpolate_rates
from stillpoint.smoother.spin.encoder import EncoderReadings, select_readings
from stillpoint.smoother.spin.factors import (
    Accuracy,
    Linear,
    Prior,
    compute_accuracy,
    eliminate,
    find_unobservable_constants,
    fix_constants,
    make_prior,
    require_connected_chain,
)
from stillpoint.smoother.spin.once_per_turn import Line, find_line, follow_line
from stillpoint.smoother.spin.params import SpinGraphParams
from stillpoint.smoother.spin.plausibility import GLITCH, require_agreement
from stillpoint.smoother.spin.rows import compute_roots
from stillpoint.smoother.spin.samples import SpinSamples, find_sign, measure_samples
from stillpoint.smoother.spin.solve import SpinSolution, improve, make_no_optimum
from stillpoint.smoother.spin.start import add_gravity, add_vibration, make_start
from stillpoint.smoother.spin.state import AMPLITUDE, CONSTANTS, COS_S, OFFSET
from stillpoint.smoother.spin.zero_rate import find_least_squared, find_slow_stretch, require_spin, smooth_squared

_ROUGH = 3  # iterations before gravity is looked for
_VIBRATION_ROUNDS = 2  # the vibration disturbs the rates, and through them the angle along which it is fitted


def make_spin_reference(recording: Recording, params: SpinGraphParams) -> SpinReference:
    """Return angle and rate about the spin axis at every sample of the accelerometers.

    If gravity shows at the spin frequency, the angle is measured from it: at 0 the body's z axis points up as far as
    the spin axis allows. With an encoder it is the encoder's angle. Otherwise it is 0 at the first sample, and drifts.
    Raises :class:`Unobservable` when the samples do not determine the rate or contradict each other.
    """
    samples = measure_samples(recording, params.noise)
    readings = None
    if params.encoder.use:
        if recording.encoder is None:
            raise Unobservable(f"{recording.name}: has no encoder; leave encoder.use off")
        readings = select_readings(recording.encoder, samples.t_ns, params.encoder)
    require_spin(samples, params.calibration, recording.name)
    known = find_sign(recording.spin, params.calibration) if recording.spin is not None else None
    sign = known or (1.0 if params.direction == "positive" else -1.0)
    try:
        found = _solve(samples, readings, sign, params, recording.name)
    except Unobservable as error:
        squared, least = smooth_squared(samples), find_least_squared(samples, params.calibration)
        raise find_slow_stretch(samples, squared, least, readings, recording.name) or error from error
    chain, solution, line = found.chain, found.solution, found.line
    least = find_least_squared(samples, params.calibration, line)
    slow = find_slow_stretch(samples, interpolate_rates(chain, solution.at.state) ** 2, least, readings, recording.name)
    if slow is not None:
        raise slow
    least_radps = float(np.sqrt(find_least_squared(samples, params.calibration))) / 2
    require_agreement(chain, solution, found.prior, least_radps, recording.name)
    linear = _linearise(chain, solution, found.prior, recording.name)
    accuracy = compute_accuracy(chain, linear, recording.name)
    return SpinReference(
        t_ns=samples.t_ns,
        angle_rad=integrate_angles(chain, solution.at.state),
        rate_radps=interpolate_rates(chain, solution.at.state),
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
    """The optimum, and the problem that it solves."""

    chain: Chain
    prior: Prior  # before any constant is fixed
    held: NDArray[np.bool_]  # (11,) constants fixed because the samples do not determine them
    line: Line | None
    solution: SpinSolution


def _solve(
    samples: SpinSamples, readings: EncoderReadings | None, sign: float, params: SpinGraphParams, name: str
) -> _Solved:
    """Return the optimum, with gravity, vibration and unobservable constants found on the way."""
    chain = build_chain(samples, readings, int(params.block), params.calibration.step_s, params.noise)
    state = make_start(chain, readings, sign)
    require_connected_chain(chain, len(state.constants), name)
    prior = make_prior(samples, None, readings is not None, float(integrate_angles(chain, state)[0]), params)
    # Until the once-per-turn line is found, it would count as glitches beside a given noise: use the residuals.
    loose = replace(params, noise=replace(params.noise, source="data"))
    rough = improve(chain, state, prior, name, loose, _ROUGH)
    line = None if params.harmonic.search == "off" else find_line(chain, rough.at.state, params.harmonic)
    if line is not None and line.is_gravity:
        chain, state = add_gravity(chain, rough.at.state, line)
        prior = make_prior(samples, line, readings is not None, float(integrate_angles(chain, state)[0]), params)
        rough = improve(chain, state, prior, name, loose, _ROUGH)
    if line is not None and line.is_vibration:
        for _ in range(_VIBRATION_ROUNDS):
            line = follow_line(chain, rough.at.state, line, params.harmonic)
            chain, state = add_vibration(chain, rough.at.state, line)
            prior = make_prior(samples, line, readings is not None, float(integrate_angles(chain, state)[0]), params)
            rough = improve(chain, state, prior, name, loose, _ROUGH)
    # A constant that the samples do not determine would follow their noise and turn the angle by degrees. It is fixed
    # at its prior mean; the covariance still includes it.
    held = find_unobservable_constants(_linearise(chain, rough, prior, name), prior, name)
    state = replace(rough.at.state, constants=np.where(held, prior.mean, rough.at.state.constants))
    solution = improve(chain, state, fix_constants(prior, held), name, params, int(params.iterations))
    if not solution.steps_radps[-1] < params.rate_limit_radps:
        raise make_no_optimum(name, solution)
    return _Solved(chain, prior, held, line, solution)


def _linearise(chain: Chain, solution: SpinSolution, prior: Prior, name: str) -> Linear:
    return eliminate(chain, solution.at, compute_roots(chain, solution.at, solution.sizes), prior, name)


def _diagnostics(chain: Chain, solution: SpinSolution, accuracy: Accuracy, line: Line | None) -> dict[str, Any]:
    samples, sizes, n = chain.samples, solution.sizes, len(chain.samples)
    roots = compute_roots(chain, solution.at, sizes)
    facts = {
        "angle": _describe_zero(chain, line),
        "iterations": len(solution.steps_radps),
        "accel_sd_radps2": sizes.accel_radps2,
        "squared_sd_rad2ps2": sizes.squared_rad2ps2,
        "n_accel_missing": int(n - samples.accel_valid.sum()),
        "n_squared_missing": int(n - samples.squared_valid.sum()),
        "n_accel_glitches": int(((roots.accel * sizes.accel_radps2 < GLITCH) & chain.accel_seen).sum()),
        "n_squared_glitches": int(((roots.squared * sizes.squared_rad2ps2 < GLITCH) & chain.squared_valid).sum()),
        "n_gaps": int((chain.step_s > LONG_STEP * np.median(chain.step_s)).sum()),
        **_list_constants(solution, accuracy, CONSTANTS[:AMPLITUDE]),
    }
    if line is not None:
        facts |= _list_once_per_turn(line)
    if line is not None and line.is_gravity:
        facts |= _list_constants(solution, accuracy, CONSTANTS[AMPLITUDE : AMPLITUDE + 1])
    if line is not None and line.is_vibration:
        facts |= _list_constants(solution, accuracy, CONSTANTS[COS_S:])
    if chain.readings is not None and roots.encoder is not None:
        facts |= _list_constants(solution, accuracy, CONSTANTS[OFFSET:COS_S])
        facts["encoder_resolution_rad"] = chain.readings.resolution_rad
        facts["encoder_sd_rad"] = sizes.encoder_rad
        facts["n_encoder_outside"] = chain.readings.outside
        facts["n_encoder_glitches"] = int((roots.encoder * sizes.encoder_rad < GLITCH).sum())
    return facts


def _list_once_per_turn(line: Line) -> dict[str, Any]:
    """Return what was found once per turn, and gravity as each channel shows it by itself."""
    return {
        "once_per_turn": line.verdict,
        "once_per_turn_why": line.why,
        "once_per_turn_significance_sd": line.significance,
        "gravity_by_squared_mps2": line.by_squared_mps2,
        "gravity_by_accel_mps2": line.by_accel_mps2,
        "ripple_radps": line.ripple_radps,
    }


def _describe_zero(chain: Chain, line: Line | None) -> str:
    if line is not None and line.is_gravity:
        return "from gravity: 0 where the z axis points up most"
    if chain.readings is not None:
        return "the encoder's"
    drifts = "from 0 at the first sample; nothing fixes it after: the rate is a reference, the angle drifts"
    if line is not None and line.is_vibration:
        return f"{drifts}; once per turn there is something that was not taken for gravity: see once_per_turn_why"
    return drifts


def _list_constants(solution: SpinSolution, accuracy: Accuracy, names: Sequence[str]) -> dict[str, list[float]]:
    """Return value and sd of constants in their first step."""
    value, sd = solution.at.state.constants[0], accuracy.constants_sd
    return {name: [float(value[k]), float(sd[k])] for k, name in enumerate(CONSTANTS) if name in names}
