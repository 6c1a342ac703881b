"""Run an estimator of a spin over a recording, piece by piece."""

from dataclasses import asdict, replace
from time import perf_counter_ns
from typing import Any, Protocol

import numpy as np

from stillpoint.datasets.errors import BadParameter, BadRecording
from stillpoint.datasets.recording import Head, Spin
from stillpoint.datasets.settings import Settings
from stillpoint.datasets.spin import SpinChannels
from stillpoint.datasets.trajectory import Estimate
from stillpoint.filters.precision import Precision, to_precision
from stillpoint.filters.sample import collect_counts
from stillpoint.filters.spin import front as spin_front
from stillpoint.filters.spin.direction import describe_direction
from stillpoint.filters.spin.noise import SpinParams, make_channels
from stillpoint.filters.spin.sample import SpinTrack, empty_track
from stillpoint.filters.table import SpinEstimator


class _Samples(Protocol):
    """A recording or a piece of it."""

    @property
    def spin(self) -> Spin | None: ...


class SpinRun:
    """An estimator of a spin that goes through a recording piece by piece; the angle is 0 at the first sample.

    Raises :class:`BadRecording` without a spin. A piece raises :class:`Unobservable` where the geometry does not fix
    rate and angular acceleration, :class:`BadParameter` where the filter loses its variance by its parameters.
    """

    def __init__(self, head: Head, name: str, entry: SpinEstimator, params: Settings, precision: Precision) -> None:
        if "spin" not in head.samples:
            raise BadRecording(f"{head.name}: has no accelerometers on a spinning body (spin); {name} needs them")
        assert isinstance(params, SpinParams)
        self._recording, self._name, self._entry, self._params = head.name, name, entry, params
        self._precision = precision
        self._by: SpinChannels | None = None
        self._front_c: spin_front.Coefficients
        self._c: Any
        self._state: Any
        self._passed = spin_front.start()
        self._start_ns = 0
        self._is_begun = False  # the estimator has said that it is ready
        self._elapsed_ns = self._n = self._n_near_zero = 0

    def add(self, piece: _Samples) -> Estimate | None:
        """Return the estimate at the samples of the spin in the next piece."""
        if piece.spin is None:
            return None
        spin, entry, params, precision = piece.spin, self._entry, self._params, self._precision
        if self._by is None:
            self._by = make_channels(params, spin.geometry)
            self._front_c = spin_front.coefficients(self._by, params, precision)
            self._c = to_precision(entry.coefficients(params, spin.geometry), precision)
            self._state = to_precision(entry.start(self._c), precision)
            self._start_ns = int(spin.t_ns[0])
        self._passed, log = spin_front.filter_log(
            spin.t_ns, spin.accel_mps2, spin.gyro_radps, self._passed, self._front_c
        )
        track = empty_track(len(log.dt_s))
        if self._n == 0:  # no sample: compiles, which is not to be timed
            entry.run(log._replace(dt_s=log.dt_s[:0]), self._state, self._c, track)
        begun = perf_counter_ns()
        state = entry.run(log, self._state, self._c, track)
        self._elapsed_ns += perf_counter_ns() - begun
        self._state = to_precision(state, precision)  # compiled code returns Python's floats
        self._n_near_zero += _count_near_zero(track, self._by)
        lost = collect_counts(self._state).get("n_variance_not_positive")
        if lost:
            raise BadParameter(self._describe_lost_variance(lost, spin, track))
        self._is_begun = self._is_begun or bool(track.ready.any())
        self._n += len(spin.t_ns)
        return Estimate(
            t_ns=spin.t_ns,
            name=self._name,
            recording=self._recording,
            angle_rad=track.angle_rad,
            rate_radps=track.rate_radps,
            angle_sd_rad=np.sqrt(track.angle_var),
            rate_sd_radps=np.sqrt(track.rate_var),
            innovation=track.innovation[:, None] if entry.innovations else None,
            ready=track.ready,
            params=asdict(params),
        )

    def close(self, last: Estimate) -> Estimate:
        """Return the last piece with the diagnostics of the whole run."""
        assert self._by is not None
        diagnostics = (
            collect_counts(self._passed)
            | collect_counts(self._state)
            | {
                "n_near_zero": self._n_near_zero,
                "precision": self._precision,
                "direction": _describe_direction(self._by, self._params),
            }
        )
        return replace(last, diagnostics=diagnostics, ns_per_sample=self._elapsed_ns / self._n)

    def _describe_lost_variance(self, count: int, spin: Spin, track: SpinTrack) -> str:
        begun = 0 if self._is_begun else int(np.argmax(track.ready))
        first = begun + int(np.argmin(track.ready[begun:]))
        at_s = (spin.t_ns[first] - self._start_ns) / 1e9
        return (
            f"{self._name}: its variance is not positive at sample {self._n + first} ({at_s:.3f} s), {count} times: "
            "lambda in (19) and in (20) makes K H exceed 1; take fading = once"
        )


def _count_near_zero(track: SpinTrack, by: SpinChannels) -> int:
    """Count samples whose rate is within the noise of its square, sqrt(sqrt(R)), which then hides the sense."""
    return int((track.rate_radps**2 < np.sqrt(by.r_rad2ps4)).sum())


def _describe_direction(by: SpinChannels, params: SpinParams) -> str:
    """Return how the sense of the spin is known, or that it is assumed."""
    return describe_direction(by) or (
        f"assumed {params.direction}: the accelerometers show the square of the rate, so a start in the other sense, "
        "and a return after the rate came near zero, would not be seen"
    )
