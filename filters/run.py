"""``estimate(recording, name)``: an estimator over a whole recording."""

from collections.abc import Mapping
from dataclasses import asdict
from time import perf_counter_ns
from typing import Any

import numpy as np

from stillpoint.datasets import BadParameter, Estimate, Recording
from stillpoint.datasets.earth import declination_rad
from stillpoint.datasets.frames import heading_rotation, quaternion, rotation
from stillpoint.datasets.settings import Settings, chosen
from stillpoint.filters import peers
from stillpoint.filters.precision import Precision, in_precision
from stillpoint.filters.sample import GAP_S, Floats, Log, Track, counts
from stillpoint.filters.table import Estimator, Peer, find


def estimate(
    recording: Recording,
    name: str,
    params: Settings | Mapping[str, Any] | None = None,
    precision: Precision = "double",
) -> Estimate:
    """What the estimator ``name`` of :data:`ESTIMATORS` says at every IMU sample of ``recording``.

    At each IMU sample a filter gets the newest field that it has not had, if there is one (``mag.t_ns <= t_ns``). The
    declination comes from the recording's date and place; without them n is magnetic East-North-Up, and the
    diagnostics say so. Diagnostics that begin with ``n_`` are counts of what was left out or met.

    Parameters
    ----------
    recording
        With an IMU; the magnetometer is optional.
    name
        A key of :data:`ESTIMATORS`.
    params
        An instance of the estimator's ``Params``, or a mapping with the fields that differ from their default.
    precision
        ``"single"``: every operation in float32, as on a microcontroller (not for peers).

    Raises
    ------
    BadParameter
        Unknown name, unknown or impossible parameter, missing package of a peer.
    BadRecording
        No IMU.
    """
    entry = find(name)
    settings = chosen(entry.params(), params, name)
    imu = recording.require_imu()
    declination, source = local_declination(recording)
    if isinstance(entry, Peer):
        if precision != "double":
            raise BadParameter(f"{name}: computes in its package's precision; leave precision out")
        data, facts = peers.at_constant_rate(recording)
        begun = perf_counter_ns()
        found = entry.batch(data, settings)
        elapsed_ns = perf_counter_ns() - begun
        columns = found._replace(q_nb=to_true_north(found.q_nb, declination))._asdict()
    else:
        log, facts = as_log(recording)
        columns, counted, elapsed_ns = _run(entry, log, settings, declination, precision)
        facts |= counted | {"precision": precision}
    return Estimate(
        t_ns=imu.t_ns,
        name=name,
        recording=recording.name,
        params=asdict(settings),
        diagnostics=facts | {"declination_rad": declination, "declination": source},
        ns_per_sample=elapsed_ns / len(imu.t_ns),
        **columns,
    )


def as_log(recording: Recording) -> tuple[Log, dict[str, Any]]:
    """The samples in the order in which a stream would bring them, and counts of what is irregular in them."""
    imu, mag = recording.require_imu(), recording.mag
    dt_s = np.diff(imu.t_ns, prepend=imu.t_ns[0]) / 1e9
    mag_row = np.full(len(dt_s), -1, dtype=np.int64)
    facts: dict[str, Any] = {"n_imu_gaps": int((dt_s > GAP_S).sum())}
    if mag is None:
        nothing = np.zeros((1, 3))
        nothing.flags.writeable = False  # as a recording's columns are: the same compiled code serves both
        return Log(dt_s, imu.gyro_b_radps, imu.accel_b_mps2, nothing, mag_row), facts
    newest = np.searchsorted(mag.t_ns, imu.t_ns, side="right") - 1
    is_new = np.diff(newest, prepend=-1) > 0
    mag_row[is_new] = newest[is_new]
    facts["n_mag_unused"] = len(mag.t_ns) - int(is_new.sum())
    return Log(dt_s, imu.gyro_b_radps, imu.accel_b_mps2, mag.mag_b_ut, mag_row), facts


def local_declination(recording: Recording) -> tuple[float, str]:
    """The declination (rad, east positive) at the recording's place and date, 0 where they are not known, and why."""
    place, date = recording.info.place_lat_lon_alt, recording.info.date
    if recording.mag is None:
        return 0.0, "no magnetometer: the heading of n is arbitrary"
    if place is None or not date:
        return 0.0, "date or place not known: n is magnetic East-North-Up"
    try:
        return declination_rad(place, date), f"World Magnetic Model at {place[0]:g}, {place[1]:g} deg on {date}"
    except BadParameter as error:
        return 0.0, f"n is magnetic East-North-Up: {error}"


def to_true_north(q_nb: Floats, declination: float) -> Floats:
    """Attitudes (N, 4) from magnetic to true East-North-Up; the same bits for a declination of 0."""
    if declination == 0.0:
        return q_nb
    return quaternion(heading_rotation(-declination) * rotation(q_nb))


def _run(
    entry: Estimator, log: Log, params: Settings, declination: float, precision: Precision
) -> tuple[dict[str, Any], dict[str, int], int]:
    """Columns of the estimate, counts, and the time of the compiled run in ns."""
    c = in_precision(entry.coefficients(params, declination), precision)
    log = in_precision(log, precision)
    n = len(log.dt_s)
    track = Track(
        q_nb=np.empty((n, 4)),
        gyro_bias_b_radps=np.empty((n, 3)) if entry.gives_bias else None,
        cov_b_rad2=np.empty((n, 9)) if entry.gives_cov else None,
        innovation=np.empty((n, entry.innovations)) if entry.innovations else None,
        ready=np.empty(n, dtype=np.bool_),
    )
    begin = in_precision(entry.start(c), precision)
    entry.run(log._replace(dt_s=log.dt_s[:0]), begin, c, track)  # no sample: compiles, which is not to be timed
    begun = perf_counter_ns()
    state = entry.run(log, begin, c, track)
    elapsed_ns = perf_counter_ns() - begun
    columns = track._asdict()
    if track.cov_b_rad2 is not None:
        columns["cov_b_rad2"] = track.cov_b_rad2.reshape(n, 3, 3)
    return columns, counts(state), elapsed_ns
