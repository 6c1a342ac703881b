"""An estimator of roll over a whole recording."""

from dataclasses import asdict, replace
from time import perf_counter_ns

import numpy as np

from stillpoint.datasets.errors import BadParameter, BadRecording
from stillpoint.datasets.recording import Floats, Recording, Spin, SpinGeometry
from stillpoint.datasets.settings import Settings
from stillpoint.datasets.spin import SpinChannels, measure, saturated
from stillpoint.datasets.trajectory import Estimate
from stillpoint.filters.precision import Precision, in_precision
from stillpoint.filters.roll_direction import Evidence, directions, no_evidence, says_direction
from stillpoint.filters.roll_noise import RollParams, spin_channels
from stillpoint.filters.roll_sample import RollLog, RollTrack, empty_track
from stillpoint.filters.sample import GAP_S, counts
from stillpoint.filters.table import RollEstimator


def estimate_roll(
    recording: Recording, name: str, entry: RollEstimator, params: Settings, precision: Precision = "double"
) -> Estimate:
    """What an estimator of roll says at every sample of ``recording.spin``; the angle is 0 at the first one.

    Raises :class:`BadRecording` without a spin, :class:`Unobservable` where its geometry does not fix rate and angular
    acceleration, :class:`BadParameter` for parameters with which the filter loses its variance.
    """
    if recording.spin is None:
        raise BadRecording(f"{recording.name}: has no accelerometers on a spinning body (spin); {name} needs them")
    assert isinstance(params, RollParams)
    spin = recording.spin
    by = spin_channels(params, spin.geometry)
    log, _ = as_roll_log(spin, by, np.diff(spin.t_ns, prepend=spin.t_ns[0]) / 1e9, no_evidence())
    track, met, elapsed_ns = _run(entry, log, params, spin.geometry, precision)
    if met.get("n_variance_not_positive"):
        raise BadParameter(_lost_variance(name, met["n_variance_not_positive"], spin, track))
    return Estimate(
        t_ns=spin.t_ns,
        name=name,
        recording=recording.name,
        angle_rad=track.angle_rad,
        rate_radps=track.rate_radps,
        angle_sd_rad=np.sqrt(track.angle_var),
        rate_sd_radps=np.sqrt(track.rate_var),
        innovation=track.innovation[:, None] if entry.innovations else None,
        ready=track.ready,
        params=asdict(params),
        diagnostics=_irregular(spin, by)
        | met
        | {"n_near_zero": _near_zero(track, by), "precision": precision, "direction": _direction(by, params)},
        ns_per_sample=elapsed_ns / len(spin.t_ns),
    )


def as_roll_log(spin: Spin, by: SpinChannels, dt_s: Floats, evidence: Evidence) -> tuple[RollLog, Evidence]:
    """The samples as the estimators take them, after an evidence of the direction, and that to go on with."""
    spin = replace(spin, geometry=by.geometry)  # without a range, where saturated samples are to be used
    seen = measure(spin, by)
    direction, evidence = directions(spin, by, evidence)
    log = RollLog(
        dt_s,
        seen.omega_dot_radps2,
        seen.omega_squared_radps2,
        seen.omega_dot_valid,
        seen.omega_squared_valid,
        direction,
    )
    return log, evidence


def _run(
    entry: RollEstimator, log: RollLog, params: RollParams, geometry: SpinGeometry, precision: Precision
) -> tuple[RollTrack, dict[str, int], int]:
    """Columns, counts, and the time of the compiled run in ns."""
    c = in_precision(entry.coefficients(params, geometry), precision)
    log = in_precision(log, precision)
    track = empty_track(len(log.dt_s))
    entry.run(log._replace(dt_s=log.dt_s[:0]), in_precision(entry.start(c), precision), c, track)  # compiles
    begin = in_precision(entry.start(c), precision)
    begun = perf_counter_ns()
    state = entry.run(log, begin, c, track)
    return track, counts(state), perf_counter_ns() - begun


def _irregular(spin: Spin, by: SpinChannels) -> dict[str, int]:
    """Counts of what is irregular in the samples."""
    used = (by.omega_dot.accel != 0) | (by.omega_squared.accel != 0)
    return {
        "n_spin_gaps": int((np.diff(spin.t_ns) > GAP_S * 1e9).sum()),
        "n_lost": int((~np.isfinite(spin.accel_mps2[:, used])).any(axis=1).sum()),
        "n_saturated": int(saturated(spin)[:, used].any(axis=1).sum()),
    }


def _near_zero(track: RollTrack, by: SpinChannels) -> int:
    """Samples whose rate is within the noise of its square, sqrt(sqrt(R)): there the square does not tell the sense."""
    return int((track.rate_radps**2 < np.sqrt(by.r_rad2ps4)).sum())


def _direction(by: SpinChannels, params: RollParams) -> str:
    """How the sense of the spin is known, or that it is assumed."""
    return says_direction(by) or (
        f"assumed {params.direction}: the accelerometers show the square of the rate, so a start in the other sense, "
        "and a return after the rate came near zero, would not be seen"
    )


def _lost_variance(name: str, count: int, spin: Spin, track: RollTrack) -> str:
    begun = int(np.argmax(track.ready))
    first = begun + int(np.argmin(track.ready[begun:]))
    at_s = (spin.t_ns[first] - spin.t_ns[0]) / 1e9
    return (
        f"{name}: its variance is not positive at sample {first} ({at_s:.3f} s), {count} times in all: lambda in (19) "
        "and in (20) makes K H exceed 1; take fading = once"
    )
