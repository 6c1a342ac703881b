"""``estimate(recording, name)``: an estimator over a whole recording."""

from collections.abc import Mapping
from dataclasses import asdict
from time import perf_counter_ns
from typing import Any

import numpy as np

from stillpoint.datasets import BadParameter, Estimate, Imu, Mag, Recording
from stillpoint.datasets.earth import local_declination
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
    declination comes from the recording's date and place; without them n is magnetic East-North-Up. A magnetometer
    that is not calibrated is left out. The diagnostics say what the heading refers to; those that begin with ``n_``
    are counts of what was left out or met.

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
    mag, declination, facts = heading_source(recording)
    if isinstance(entry, Peer):
        if precision != "double":
            raise BadParameter(f"{name}: computes in its package's precision; leave precision out")
        data, counted = peers.at_constant_rate(imu, mag)
        begun = perf_counter_ns()
        found = entry.batch(data, settings)
        elapsed_ns = perf_counter_ns() - begun
        columns = found._replace(q_nb=to_true_north(found.q_nb, declination))._asdict()
    else:
        log, counted = as_log(imu, mag)
        columns, met, elapsed_ns = _run(entry, log, settings, declination, precision)
        counted |= met | {"precision": precision}
    return Estimate(
        t_ns=imu.t_ns,
        name=name,
        recording=recording.name,
        params=asdict(settings),
        diagnostics=counted | facts,
        ns_per_sample=elapsed_ns / len(imu.t_ns),
        **columns,
    )


def heading_source(recording: Recording) -> tuple[Mag | None, float, dict[str, Any]]:
    """The magnetometer to use, if there is one, the declination (rad, east positive), and words about both.

    One that is not calibrated is not used: a hard iron of the field's size or more makes every heading wrong.
    """
    facts: dict[str, Any] = {"declination_rad": 0.0}
    if recording.mag is None:
        return None, 0.0, facts | {"heading": "arbitrary: there is no magnetometer"}
    if recording.info.mag_uncalibrated:
        facts["n_mag_uncalibrated"] = len(recording.mag.t_ns)
        return None, 0.0, facts | {"heading": "arbitrary: the magnetometer is not calibrated"}
    declination, heading = local_declination(recording.info)
    return recording.mag, declination, {"declination_rad": declination, "heading": heading}


def as_log(imu: Imu, mag: Mag | None) -> tuple[Log, dict[str, Any]]:
    """The samples in the order in which a stream would bring them, and counts of what is irregular in them."""
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
