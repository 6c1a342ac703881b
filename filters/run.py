"""``estimate(recording, name)``: an estimator over a whole recording."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from time import perf_counter_ns
from typing import Any

import numpy as np

from stillpoint.datasets import BadParameter, Estimate, Imu, Mag, Recording
from stillpoint.datasets.frames import heading_rotation, quaternion, rotation
from stillpoint.datasets.measurements import drop_non_fields
from stillpoint.datasets.recording import Floats
from stillpoint.datasets.settings import Settings, choose_settings
from stillpoint.filters import peers
from stillpoint.filters.front.heading_source import Heading
from stillpoint.filters.front.sources import Sources, find_sources, prepare_log, record_choices
from stillpoint.filters.precision import Precision, compare_with_double, to_precision
from stillpoint.filters.sample import Log, Track, collect_counts
from stillpoint.filters.spin.run import estimate_spin
from stillpoint.filters.table import Estimator, Peer, SpinEstimator, find_estimator

PAGE = 4096  # bytes; the least that the system gives at a time


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
    are counts of what was left out or met, and ``asked`` holds ``heading``, ``heading_params`` and ``ranges`` where
    they are not the defaults.

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
    settings = choose_settings(entry.params(), params, name)
    if isinstance(entry, SpinEstimator):
        if heading != "mag" or heading_params or ranges:
            raise BadParameter(f"{name}: follows a spin, which has no heading; leave heading and ranges out")
        one = partial(estimate_spin, recording, name, entry, settings)
    else:
        if isinstance(entry, Peer) and precision != "double":
            raise BadParameter(f"{name}: computes in its package's precision; leave precision out")
        imu, sources = recording.require_imu(), find_sources(recording, heading, heading_params, ranges)
        sources = sources._replace(facts=sources.facts | record_choices(heading, heading_params, ranges))
        one = partial(_estimate_attitude, recording.name, imu, name, entry, settings, sources)
    made = one(precision)
    if precision == "double":
        return made
    return replace(made, diagnostics={**made.diagnostics, **compare_with_double(made, one("double"))})


def _estimate_attitude(
    recording: str,
    imu: Imu,
    name: str,
    entry: Estimator | Peer,
    settings: Settings,
    sources: Sources,
    precision: Precision,
) -> Estimate:
    log, facts = prepare_log(imu, sources, precision)
    if isinstance(entry, Peer):
        columns, met, elapsed_ns = _run_peer(entry, settings, imu, log, sources)
    else:
        columns, met, elapsed_ns = _run(entry, log, settings, sources.declination_rad, precision)
    return Estimate(
        t_ns=imu.t_ns,
        name=name,
        recording=recording,
        params=asdict(settings),
        diagnostics=facts | met,
        ns_per_sample=elapsed_ns / len(imu.t_ns),
        **columns,
    )


def _to_true_north(q_nb: Floats, declination_rad: float) -> Floats:
    """Return attitudes (N, 4) in true instead of magnetic East-North-Up; unchanged for a declination of 0."""
    if declination_rad == 0.0:
        return q_nb
    return quaternion(heading_rotation(-declination_rad) * rotation(q_nb))


def _allocate(shape: tuple[int, int]) -> Floats:
    """Return an array whose memory pages exist: getting them takes as long as a fast filter, and must not be timed."""
    made = np.empty(shape)
    made.reshape(-1)[:: PAGE // made.itemsize] = 0.0
    return made


def _run_peer(
    entry: Peer, params: Settings, imu: Imu, log: Log, sources: Sources
) -> tuple[dict[str, Any], dict[str, Any], int]:
    """Run a peer, as :func:`_run`. A peer cannot leave a sample out, so it gets the accelerometer as recorded.

    A field that is no measurement is left out and counted: the package ahrs refuses zeros.
    """
    mag = sources.mag
    counted: dict[str, int] = {}
    if sources.gps is not None:
        imu = Imu(imu.t_ns, log.gyro_b_radps, imu.accel_b_mps2)
        mag = Mag(imu.t_ns[log.has_mag], log.mag_b_ut[log.has_mag]) if log.has_mag.any() else None
    if mag is not None:
        mag, dropped = drop_non_fields(mag, imu)
        counted = dropped.counts()
    data, met = peers.at_constant_rate(imu, mag)
    begun = perf_counter_ns()
    found = entry.batch(data, params)
    elapsed_ns = perf_counter_ns() - begun
    columns = found._replace(q_nb=_to_true_north(found.q_nb, sources.declination_rad))._asdict()
    return columns, met | counted, elapsed_ns


def _run(
    entry: Estimator, log: Log, params: Settings, declination_rad: float, precision: Precision
) -> tuple[dict[str, Any], dict[str, Any], int]:
    """Return the columns of the estimate, counts, and the time of the estimator's compiled run in ns."""
    c = to_precision(entry.coefficients(params, declination_rad), precision)
    n = len(log.dt_s)
    track = Track(
        q_nb=_allocate((n, 4)),
        gyro_bias_b_radps=_allocate((n, 3)) if entry.gives_bias else None,
        cov_b_rad2=_allocate((n, 9)) if entry.gives_cov else None,
        innovation=_allocate((n, entry.innovations)) if entry.innovations else None,
        ready=np.empty(n, dtype=np.bool_),
    )
    begin = to_precision(entry.start(c), precision)
    entry.run(log._replace(dt_s=log.dt_s[:0]), begin, c, track)  # no sample: compiles, which is not to be timed
    begun = perf_counter_ns()
    state = entry.run(log, begin, c, track)
    elapsed_ns = perf_counter_ns() - begun
    columns = track._asdict()
    if track.cov_b_rad2 is not None:
        columns["cov_b_rad2"] = track.cov_b_rad2.reshape(n, 3, 3)
    return columns, collect_counts(state) | {"precision": precision}, elapsed_ns
