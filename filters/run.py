"""``estimate(recording, name)``: an estimator over a whole recording, or piece by piece over one of any length."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import partial
from time import perf_counter_ns
from typing import Any, Protocol

import numpy as np

from stillpoint.datasets import BadParameter, BadRecording, Estimate, Gps, Imu, Mag, Recording, Spin
from stillpoint.datasets.frames import heading_rotation, quaternion, rotation
from stillpoint.datasets.measurements import drop_non_fields
from stillpoint.datasets.recording import Floats, Head
from stillpoint.datasets.settings import Settings, choose_settings
from stillpoint.filters import peers
from stillpoint.filters.front.heading_source import Heading
from stillpoint.filters.front.sources import (
    FrontRun,
    Plan,
    find_sources,
    plan_sources,
    prepare_log,
    record_choices,
)
from stillpoint.filters.precision import DoubleComparison, Precision, to_precision
from stillpoint.filters.sample import Track, collect_counts
from stillpoint.filters.spin.run import SpinRun
from stillpoint.filters.table import Estimator, Peer, SpinEstimator, find_estimator

_PAGE = 4096  # bytes; the least that the system gives at a time


def estimate(
    recording: Recording,
    name: str,
    params: Settings | Mapping[str, Any] | None = None,
    precision: Precision = "double",
    heading: Heading = "mag",
    *,
    heading_params: Settings | Mapping[str, Any] | None = None,
    ranges: Settings | Mapping[str, Any] | None = None,
) -> Estimate:
    """Return what the estimator ``name`` of :data:`ESTIMATORS` estimates at every IMU sample of ``recording``.

    At each IMU sample a filter gets the newest field that it has not had, if there is one (``mag.t_ns <= t_ns``). The
    declination comes from the recording's date and place; without them n is magnetic East-North-Up. A magnetometer
    that is not calibrated is left out. The diagnostics say what the heading refers to; those that begin with ``n_``
    are counts of samples left out or handled specially, and ``asked`` holds ``heading``, ``heading_params`` and
    ``ranges`` where they are not the defaults.

    Parameters
    ----------
    recording
        With an IMU; the magnetometer is optional.
    name
        A key of :data:`ESTIMATORS`.
    params
        An instance of the estimator's ``Params``, or a mapping with the fields that differ from their default.
    precision
        ``"single"``: every operation in float32, as on a microcontroller (not for peers); how far that is off a run
        in double precision is in the diagnostics, ``off_double_max_deg`` and ``off_double_rms_deg``.
    heading
        ``"gps-course"``: the course of satellite fixes while they are valid, and the magnetometer, calibrated by
        them, otherwise; see :mod:`stillpoint.filters.front.heading_source`.
    heading_params
        Of ``"gps-course"``, likewise.
    ranges
        Full scales of the sensors (:class:`stillpoint.filters.front.guard.Ranges`), to detect saturation.

    Raises
    ------
    BadParameter
        Unknown name, unknown or impossible parameter, missing package of a peer.
    BadRecording
        No IMU; or no satellite fixes, when the heading is to come from them.
    """
    entry = find_estimator(name)
    if isinstance(entry, Peer):
        return _estimate_by_peer(recording, name, entry, params, precision, heading, heading_params, ranges)
    run = start_run(recording.head, name, params, precision, heading, heading_params=heading_params, ranges=ranges)
    made = run.add(recording)
    assert made is not None  # the run has found the stream that it needs
    return run.close(made)


class Samples(Protocol):
    """The streams of a recording or of a piece of it; None for one without a sample."""

    @property
    def imu(self) -> Imu | None: ...  # noqa: D102
    @property
    def mag(self) -> Mag | None: ...  # noqa: D102
    @property
    def gps(self) -> Gps | None: ...  # noqa: D102
    @property
    def spin(self) -> Spin | None: ...  # noqa: D102


class Run(Protocol):
    """An estimator that goes through a recording piece by piece; where the pieces end changes no bit of its output."""

    def add(self, piece: Samples, /) -> Estimate | None:
        """Return the estimate at the samples of the next piece, without diagnostics; None where it has no sample."""

    def close(self, last: Estimate, /) -> Estimate:
        """Return the last piece with the diagnostics of the whole run."""


def start_run(
    head: Head,
    name: str,
    params: Settings | Mapping[str, Any] | None = None,
    precision: Precision = "double",
    heading: Heading = "mag",
    *,
    heading_params: Settings | Mapping[str, Any] | None = None,
    ranges: Settings | Mapping[str, Any] | None = None,
) -> Run:
    """Start one of our estimators on a recording that comes in pieces; parameters and errors of :func:`estimate`.

    Raises :class:`BadParameter` for a peer: a package of another project takes a whole recording at a time.
    """
    entry = find_estimator(name)
    settings = choose_settings(entry.params(), params, name)
    if isinstance(entry, Peer):
        raise BadParameter(f"{name}: takes a whole recording at a time; use estimate")
    start: Callable[[Precision], Run]
    if isinstance(entry, SpinEstimator):
        if heading != "mag" or heading_params or ranges:
            raise BadParameter(f"{name}: follows a spin, which has no heading; leave heading and ranges out")
        start = partial(SpinRun, head, name, entry, settings)
    else:
        if "imu" not in head.samples:
            raise BadRecording(f"{head.name}: has no gyro and accelerometer (imu); use an estimator of a spin (roll-…)")
        plan = plan_sources(head, heading, heading_params, ranges)
        plan = plan._replace(facts=plan.facts | record_choices(heading, heading_params, ranges))
        start = partial(_AttitudeRun, head.name, name, entry, settings, plan)
    return start(precision) if precision == "double" else _ComparedRun(start(precision), start("double"))


class _ComparedRun:
    """A run in single precision beside one in double, and how far they are apart."""

    def __init__(self, single: Run, double: Run) -> None:
        self._single, self._double, self._comparison = single, double, DoubleComparison()

    def add(self, piece: Samples) -> Estimate | None:
        """Return the estimate in single precision at the samples of the next piece."""
        made, double = self._single.add(piece), self._double.add(piece)
        if made is not None and double is not None:
            self._comparison.add(made, double)
        return made

    def close(self, last: Estimate) -> Estimate:
        """Return the last piece with the diagnostics of the run in single precision, and how far it is off."""
        made = self._single.close(last)
        return replace(made, diagnostics={**made.diagnostics, **self._comparison.report()})


class _AttitudeRun:
    """One of our estimators of attitude, with its state between two pieces."""

    def __init__(
        self, recording: str, name: str, entry: Estimator, settings: Settings, plan: Plan, precision: Precision
    ) -> None:
        self._recording, self._name, self._entry, self._settings = recording, name, entry, settings
        self._precision = precision
        self._front = FrontRun(plan, precision)
        self._c = to_precision(entry.coefficients(settings, plan.declination_rad), precision)
        self._state = to_precision(entry.start(self._c), precision)
        self._elapsed_ns = self._n = 0

    def add(self, piece: Samples) -> Estimate | None:
        """Return the estimate at the IMU samples of the next piece."""
        if piece.imu is None:
            self._front.skip(piece.mag, piece.gps)
            return None
        log, entry, n = self._front.add(piece.imu, piece.mag, piece.gps), self._entry, len(piece.imu.t_ns)
        track = Track(
            q_nb=_allocate((n, 4)),
            gyro_bias_b_radps=_allocate((n, 3)) if entry.gives_bias else None,
            cov_b_rad2=_allocate((n, 9)) if entry.gives_cov else None,
            innovation=_allocate((n, entry.innovations)) if entry.innovations else None,
            ready=np.empty(n, dtype=np.bool_),
        )
        if self._n == 0:  # no sample: compiles, which is not to be timed
            entry.run(log._replace(dt_s=log.dt_s[:0]), self._state, self._c, track)
        begun = perf_counter_ns()
        state = entry.run(log, self._state, self._c, track)
        self._elapsed_ns += perf_counter_ns() - begun
        self._state = to_precision(state, self._precision)  # compiled code returns Python's floats
        self._n += n
        columns = track._asdict()
        if track.cov_b_rad2 is not None:
            columns["cov_b_rad2"] = track.cov_b_rad2.reshape(n, 3, 3)
        return Estimate(
            t_ns=piece.imu.t_ns,
            name=self._name,
            recording=self._recording,
            params=asdict(self._settings),
            **columns,
        )

    def close(self, last: Estimate) -> Estimate:
        """Return the last piece with the diagnostics of the whole run."""
        counts = collect_counts(self._state) | {"precision": self._precision}
        return replace(last, diagnostics=self._front.report() | counts, ns_per_sample=self._elapsed_ns / self._n)


def _to_true_north(q_nb: Floats, declination_rad: float) -> Floats:
    """Return attitudes (N, 4) in true instead of magnetic East-North-Up; unchanged for a declination of 0."""
    if declination_rad == 0.0:
        return q_nb
    return quaternion(heading_rotation(-declination_rad) * rotation(q_nb))


def _allocate(shape: tuple[int, int]) -> Floats:
    """Return an array whose memory pages exist: getting them takes as long as a fast filter, and must not be timed."""
    made = np.empty(shape)
    made.reshape(-1)[:: _PAGE // made.itemsize] = 0.0
    return made


def _estimate_by_peer(
    recording: Recording,
    name: str,
    entry: Peer,
    params: Settings | Mapping[str, Any] | None,
    precision: Precision,
    heading: Heading,
    heading_params: Settings | Mapping[str, Any] | None,
    ranges: Settings | Mapping[str, Any] | None,
) -> Estimate:
    """Return what a package of another project estimates.

    A peer cannot leave a sample out, so it gets the accelerometer as recorded. A field that is no measurement is left
    out and counted: the package ahrs refuses zeros.
    """
    settings = choose_settings(entry.params(), params, name)
    if precision != "double":
        raise BadParameter(f"{name}: computes in its package's precision; leave precision out")
    imu, sources = recording.require_imu(), find_sources(recording, heading, heading_params, ranges)
    log, facts = prepare_log(imu, sources, precision)
    t_ns, mag = imu.t_ns, sources.mag
    counted: dict[str, int] = {}
    if sources.gps is not None:
        imu = Imu(imu.t_ns, log.gyro_b_radps, imu.accel_b_mps2)
        mag = Mag(imu.t_ns[log.has_mag], log.mag_b_ut[log.has_mag]) if log.has_mag.any() else None
    if mag is not None:
        mag, dropped = drop_non_fields(mag, imu)
        counted = dropped.counts()
    data, counts = peers.at_constant_rate(imu, mag)
    begun = perf_counter_ns()
    found = entry.batch(data, settings)
    elapsed_ns = perf_counter_ns() - begun
    columns = found._replace(q_nb=_to_true_north(found.q_nb, sources.plan.declination_rad))._asdict()
    return Estimate(
        t_ns=t_ns,
        name=name,
        recording=recording.name,
        params=asdict(settings),
        diagnostics=facts | record_choices(heading, heading_params, ranges) | counts | counted,
        ns_per_sample=elapsed_ns / len(t_ns),
        **columns,
    )
