"""Run an estimator of a spin over a whole recording."""

from dataclasses import asdict
from time import perf_counter_ns

import numpy as np

from stillpoint.datasets.errors import BadParameter, BadRecording
from stillpoint.datasets.recording import Recording, Spin, SpinGeometry
from stillpoint.datasets.settings import Settings
from stillpoint.datasets.spin import SpinChannels
from stillpoint.datasets.trajectory import Estimate
from stillpoint.filters.precision import Precision, to_precision
from stillpoint.filters.sample import collect_counts
from stillpoint.filters.spin import front as roll_front
from stillpoint.filters.spin.direction import describe_direction
from stillpoint.filters.spin.noise import SpinParams, make_channels
from stillpoint.filters.spin.sample import SpinLog, SpinTrack, empty_track
from stillpoint.filters.table import SpinEstimator


def estimate_spin(
    recording: Recording, name: str, entry: SpinEstimator, params: Settings, precision: Precision = "double"
) -> Estimate:
    """Return what an estimator of a spin estimates at every sample of ``recording.spin``; the angle is 0 at the first.

    Raises :class:`BadRecording` without a spin, :class:`Unobservable` where its geometry does not fix rate and angular
    acceleration, :class:`BadParameter` for parameters with which the filter loses its variance.
    """
    if recording.spin is None:
        raise BadRecording(f"{recording.name}: has no accelerometers on a spinning body (spin); {name} needs them")
    assert isinstance(params, SpinParams)
    spin = recording.spin
    by = make_channels(params, spin.geometry)
    front_c = roll_front.coefficients(by, params, precision)
    passed, log = roll_front.filter_log(spin.t_ns, spin.accel_mps2, spin.gyro_radps, roll_front.start(), front_c)
    track, met, elapsed_ns = _run(entry, log, params, spin.geometry, precision)
    if met.get("n_variance_not_positive"):
        raise BadParameter(_describe_lost_variance(name, met["n_variance_not_positive"], spin, track))
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
        diagnostics=collect_counts(passed)
        | met
        | {
            "n_near_zero": _count_near_zero(track, by),
            "precision": precision,
            "direction": _describe_direction(by, params),
        },
        ns_per_sample=elapsed_ns / len(spin.t_ns),
    )


def _run(
    entry: SpinEstimator, log: SpinLog, params: SpinParams, geometry: SpinGeometry, precision: Precision
) -> tuple[SpinTrack, dict[str, int], int]:
    """Return the columns, counts, and the time of the compiled run in ns."""
    c = to_precision(entry.coefficients(params, geometry), precision)
    track = empty_track(len(log.dt_s))
    entry.run(log._replace(dt_s=log.dt_s[:0]), to_precision(entry.start(c), precision), c, track)  # compiles
    begin = to_precision(entry.start(c), precision)
    begun = perf_counter_ns()
    state = entry.run(log, begin, c, track)
    return track, collect_counts(state), perf_counter_ns() - begun


def _count_near_zero(track: SpinTrack, by: SpinChannels) -> int:
    """Count samples whose rate is within the noise of its square, sqrt(sqrt(R)), which then hides the sense."""
    return int((track.rate_radps**2 < np.sqrt(by.r_rad2ps4)).sum())


def _describe_direction(by: SpinChannels, params: SpinParams) -> str:
    """Return how the sense of the spin is known, or that it is assumed."""
    return describe_direction(by) or (
        f"assumed {params.direction}: the accelerometers show the square of the rate, so a start in the other sense, "
        "and a return after the rate came near zero, would not be seen"
    )


def _describe_lost_variance(name: str, count: int, spin: Spin, track: SpinTrack) -> str:
    begun = int(np.argmax(track.ready))
    first = begun + int(np.argmin(track.ready[begun:]))
    at_s = (spin.t_ns[first] - spin.t_ns[0]) / 1e9
    return (
        f"{name}: its variance is not positive at sample {first} ({at_s:.3f} s), {count} times in all: lambda in (19) "
        "and in (20) makes K H exceed 1; take fading = once"
    )
