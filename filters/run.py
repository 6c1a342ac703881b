"""``estimate(recording, name)``: an estimator over a whole recording."""

from collections.abc import Mapping
from dataclasses import asdict
from time import perf_counter_ns
from typing import Any

import numpy as np
from stillpoint.datasets import BadParameter, Estimate, Recording
from stillpoint.datasets.earth import declination_rad
from stillpoint.filters.parameters import Parameters, make
from stillpoint.filters.peers import PeerInput
from stillpoint.filters.sample import GAP_S, Log, Track
from stillpoint.filters.table import Estimator, Peer, find


def estimate(recording: Recording, name: str, params: Parameters | Mapping[str, Any] | None = None) -> Estimate:
    """What the estimator ``name`` of :data:`ESTIMATORS` says at every IMU sample of ``recording``.

    ``params`` is an instance of the estimator's ``Params``, or a mapping of the fields that differ from the default.
    A filter takes at each IMU sample the newest field that it has not used, if there is one (``mag.t_ns`` <= ``t_ns``).
    The declination comes from the recording's date and place; without them n is magnetic north, and the diagnostics say
    so. Raises :class:`BadParameter` (name, parameters, missing package) and :class:`BadRecording` (no IMU).
    """
    entry = find(name)
    chosen = make(entry.params, params)
    imu = recording.require_imu()
    log, diagnostics = columns(recording)
    if isinstance(entry, Peer):
        columns_of, facts, elapsed_ns = _run_peer(entry, recording, log, chosen)
    else:
        declination, source = local_declination(recording)
        diagnostics |= {"declination_rad": declination, "declination": source}
        columns_of, facts, elapsed_ns = _run_filter(entry, log, chosen, declination)
    return Estimate(
        t_ns=imu.t_ns,
        name=name,
        recording=recording.name,
        params=asdict(chosen),
        diagnostics=diagnostics | facts,
        ns_per_sample=elapsed_ns / len(imu.t_ns),
        **columns_of,
    )


def columns(recording: Recording) -> tuple[Log, dict[str, Any]]:
    """The samples in the order in which a stream would bring them, and counts of what is irregular in them."""
    imu, mag = recording.require_imu(), recording.mag
    dt_s = np.diff(imu.t_ns, prepend=imu.t_ns[0]) / 1e9
    row = np.full(len(dt_s), -1)
    unused = 0
    if mag is not None:
        newest = np.searchsorted(mag.t_ns, imu.t_ns, side="right") - 1
        is_new = np.diff(newest, prepend=-1) > 0
        row[is_new] = newest[is_new]
        unused = len(mag.t_ns) - int(is_new.sum())
    field = np.zeros((1, 3)) if mag is None else mag.mag_b_ut
    counts = {"n_mag_used": int((row >= 0).sum()), "n_mag_unused": unused, "n_imu_gaps": int((dt_s > GAP_S).sum())}
    return Log(dt_s, imu.gyro_b_radps, imu.accel_b_mps2, field, row), counts


def local_declination(recording: Recording) -> tuple[float, str]:
    """The declination (rad, east positive) where and when the recording was made, 0 where that is not known, and why."""
    place, date = recording.info.place_lat_lon_alt, recording.info.date
    if recording.mag is None:
        return 0.0, "no magnetometer: n has an arbitrary heading"
    if place is None or not date:
        return 0.0, "date or place unknown: n is magnetic East-North-Up"
    try:
        return declination_rad(place, date), f"World Magnetic Model at {place[0]:g}, {place[1]:g} on {date}"
    except BadParameter as error:
        return 0.0, f"not known ({error}): n is magnetic East-North-Up"


def _run_filter(
    entry: Estimator, log: Log, params: Parameters, declination: float
) -> tuple[dict[str, Any], dict[str, Any], int]:
    c = entry.coefficients(params, declination)
    n = len(log.dt_s)
    track = Track(
        np.empty((n, 4)),
        np.empty((n, 3)) if entry.gives_bias else None,
        np.empty((n, 9)) if entry.gives_cov else None,
        np.empty((n, entry.innovations)) if entry.innovations else None,
        np.empty(n, dtype=np.bool_),
    )
    first = Log(*(column[:0] if i != 3 else column for i, column in enumerate(log)))
    entry.run(first, entry.start(c), c, track)  # compiles, so that the time is that of the run
    begun = perf_counter_ns()
    state = entry.run(log, entry.start(c), c, track)
    elapsed_ns = perf_counter_ns() - begun
    return track_columns(track), counts(state), elapsed_ns


def track_columns(track: Track) -> dict[str, Any]:
    """The columns under their names in :class:`Estimate`."""
    named = track._asdict()
    if track.cov_b_rad2 is not None:
        named["cov_b_rad2"] = track.cov_b_rad2.reshape(-1, 3, 3)
    return named


def counts(state: Any) -> dict[str, int]:
    """The counts in a state: its fields, and those of states within it, that begin with ``n_``."""
    found = {}
    for name, value in state._asdict().items():
        if hasattr(value, "_asdict"):
            found |= counts(value)
        elif name.startswith("n_"):
            found[name] = int(value)
    return found


def _run_peer(
    entry: Peer, recording: Recording, log: Log, params: Parameters
) -> tuple[dict[str, Any], dict[str, Any], int]:
    imu = recording.require_imu()
    n = len(imu.t_ns)
    interval_s = (imu.t_ns[-1] - imu.t_ns[0]) / 1e9 / (n - 1) if n > 1 else 0.01
    late_s = (imu.t_ns - imu.t_ns[0]) / 1e9 - interval_s * np.arange(n)
    facts: dict[str, Any] = {"interval_s": interval_s, "worst_jitter_s": float(np.abs(late_s).max())}
    field = None
    if recording.mag is not None:
        held = np.maximum(np.searchsorted(recording.mag.t_ns, imu.t_ns, side="right") - 1, 0)
        field = np.ascontiguousarray(recording.mag.mag_b_ut[held])
        facts["worst_mag_age_s"] = float((imu.t_ns - recording.mag.t_ns[held]).max() / 1e9)
    begun = perf_counter_ns()
    track = entry.batch(PeerInput(interval_s, imu.gyro_b_radps, imu.accel_b_mps2, field), params)
    return track._asdict(), facts, perf_counter_ns() - begun
