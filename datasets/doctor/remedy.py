"""Apply remedies: each kind is one small function from a recording to a recording. Nothing changes in silence."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from stillpoint.datasets.doctor.finding import Remedy
from stillpoint.datasets.errors import BadParameter, BadRecording
from stillpoint.datasets.frames import from_xyzw, quaternion, rotation, to_xyzw
from stillpoint.datasets.recording import Floats, Imu, Mag, Recording, Times, Truth

_SENSORS = {"gyro": "gyro_b_radps", "accel": "accel_b_mps2"}
LONGEST_BURST_S = 1.0  # a longer step between stamps is a gap, not the wait for the next burst


def apply(recording: Recording, remedies: Iterable[Remedy]) -> Recording:
    """Return the recording with the remedies applied in order; each is recorded in ``info.conversions``.

    When the sizes then fit their units, ``info.units_unchecked`` is taken back. Raises :class:`BadParameter` for a
    remedy that is not one of :class:`Remedy`'s table, or whose stream is missing.
    """
    recording = replace(recording, info=replace(recording.info, units_unchecked=True))
    for remedy in remedies:
        changed, note = _apply_one(recording, remedy)
        line = f"doctor: {remedy.text}" + (f" ({note})" if note else "")
        info = replace(changed.info, conversions=(*changed.info.conversions, line))
        recording = replace(changed, info=info)
    try:
        return replace(recording, info=replace(recording.info, units_unchecked=False))
    except BadRecording:
        return recording


def fit_even_stamps(t_ns: Times) -> Times:
    """Return evenly spaced stamps by a least-squares line through each stretch without a gap.

    The stamps as they were where lines of neighbouring stretches would cross.
    """
    edges = np.concatenate([[0], np.flatnonzero(np.diff(t_ns) > LONGEST_BURST_S * 1e9) + 1, [len(t_ns)]])
    even = t_ns.astype(np.int64).copy()
    for first, last in pairwise(edges):
        if last - first > 2:
            count = np.arange(last - first, dtype=np.float64)
            since_ns = (t_ns[first:last] - t_ns[first]).astype(np.float64)
            slope, start = np.polyfit(count, since_ns, 1)
            even[first:last] = t_ns[first] + np.round(start + slope * count).astype(np.int64)
    return even if (np.diff(even) > 0).all() else t_ns


def find_repeats(values: Floats) -> np.ndarray:
    """Return True for rows that equal the row before, (N,)."""
    return np.concatenate([[False], (values[1:] == values[:-1]).all(axis=1)])


def _replace_stream(recording: Recording, stream: str, value: Imu | Mag | Truth | None) -> Recording:
    changed: dict[str, Any] = {stream: value}
    return replace(recording, **changed)


def _apply_one(recording: Recording, remedy: Remedy) -> tuple[Recording, str]:
    """Return the recording with one remedy applied and a note; raises :class:`BadParameter` where it does not fit."""
    if remedy.kind not in _KINDS:
        raise BadParameter(f"no remedy {remedy.kind!r}; there are {', '.join(_KINDS)}")
    stream = "imu" if remedy.target in _SENSORS else remedy.target
    if getattr(recording, stream, None) is None:
        raise BadParameter(f"{recording.name}: remedy {remedy.text!r} needs the stream {stream}, which is missing")
    return _KINDS[remedy.kind](recording, remedy)


def _get_values(recording: Recording, target: str) -> Floats:
    """Return the vectors (N, 3) of a sensor; raises :class:`BadParameter` for a stream that has none."""
    if target == "mag":
        assert recording.mag is not None
        return recording.mag.mag_b_ut
    if target not in _SENSORS:
        raise BadParameter(f"a remedy for {target!r} cannot change vectors; name gyro, accel or mag")
    return np.asarray(getattr(recording.require_imu(), _SENSORS[target]))


def _replace_values(recording: Recording, target: str, values: Floats) -> Recording:
    """Return the recording with other vectors (N, 3) of a sensor."""
    if target == "mag":
        assert recording.mag is not None
        return replace(recording, mag=replace(recording.mag, mag_b_ut=values))
    imu = recording.require_imu()
    changed = replace(imu, gyro_b_radps=values) if target == "gyro" else replace(imu, accel_b_mps2=values)
    return replace(recording, imu=changed)


def _multiply(recording: Recording, remedy: Remedy) -> tuple[Recording, str]:
    """Multiply the vectors of a sensor by the remedy's matrix; turn the body of the truth by its inverse."""
    matrix = np.reshape(remedy.values, (3, 3))
    if remedy.target == "truth":
        assert recording.truth is not None
        turned = rotation(recording.truth.q_nb) * Rotation.from_matrix(matrix.T)
        return replace(recording, truth=replace(recording.truth, q_nb=quaternion(turned))), ""
    return _replace_values(recording, remedy.target, _get_values(recording, remedy.target) @ matrix.T), ""


def _subtract_offset(recording: Recording, remedy: Remedy) -> tuple[Recording, str]:
    """Subtract the remedy's vector from the readings of a sensor."""
    values = _get_values(recording, remedy.target) - np.asarray(remedy.values)
    return _replace_values(recording, remedy.target, values), ""


def _shift_stream(recording: Recording, remedy: Remedy) -> tuple[Recording, str]:
    """Shift the stamps of a stream, or of one sensor of the IMU; samples before time 0 are dropped and counted."""
    by_ns = round(remedy.values[0] * 1e9)
    if remedy.target in _SENSORS:
        return _shift_within_imu(recording, remedy.target, by_ns)
    stream = getattr(recording, remedy.target)
    keep = stream.t_ns + by_ns >= 0
    lost = len(keep) - int(keep.sum())
    note = f"{lost} samples before time 0 dropped" if lost else ""
    return _replace_stream(recording, remedy.target, _select_rows(stream, keep, stream.t_ns + by_ns)), note


def _shift_within_imu(recording: Recording, sensor: str, by_ns: int) -> tuple[Recording, str]:
    """Shift gyro or accelerometer. They share a clock, so one is interpolated at the other's stamps."""
    imu = recording.require_imu()
    source_ns = imu.t_ns - by_ns
    keep = (source_ns >= imu.t_ns[0]) & (source_ns <= imu.t_ns[-1])
    seconds, at = (imu.t_ns - imu.t_ns[0]) / 1e9, (source_ns[keep] - imu.t_ns[0]) / 1e9
    moved = {
        name: np.stack([np.interp(at, seconds, column) for column in getattr(imu, name).T], axis=1)
        if name == _SENSORS[sensor]
        else getattr(imu, name)[keep]
        for name in _SENSORS.values()
    }
    note = f"interpolated at the other sensor's stamps, {len(keep) - int(keep.sum())} samples at the ends dropped"
    return replace(recording, imu=Imu(imu.t_ns[keep], moved["gyro_b_radps"], moved["accel_b_mps2"])), note


def _straighten_stamps(recording: Recording, remedy: Remedy) -> tuple[Recording, str]:
    """Put a line through the stamps of each stretch without gaps; the note says how far they move."""
    stream = getattr(recording, remedy.target)
    even = fit_even_stamps(stream.t_ns)
    note = f"stamps moved by up to {np.abs(even - stream.t_ns).max() / 1e6:.3g} ms"
    even = even - min(int(even[0]), 0)  # a line may start a little before time 0
    return _replace_stream(recording, remedy.target, replace(stream, t_ns=even)), note


def _drop_spans(recording: Recording, remedy: Remedy) -> tuple[Recording, str]:
    """Drop the samples within the remedy's spans (pairs of first and last stamp)."""
    stream = getattr(recording, remedy.target)
    keep = np.ones(len(stream.t_ns), dtype=np.bool_)
    for first, last in np.reshape(remedy.values, (-1, 2)):
        keep &= (stream.t_ns < first) | (stream.t_ns > last)
    return _keep_rows(recording, remedy.target, keep)


def _drop_repeats(recording: Recording, remedy: Remedy) -> tuple[Recording, str]:
    """Drop the samples that repeat the one before."""
    if remedy.target == "imu":
        imu = recording.require_imu()
        same = find_repeats(np.hstack([imu.gyro_b_radps, imu.accel_b_mps2]))
    else:
        same = find_repeats(_get_values(recording, remedy.target))
    return _keep_rows(recording, remedy.target, ~same)


def _keep_rows(recording: Recording, target: str, keep: np.ndarray) -> tuple[Recording, str]:
    """Keep the samples of a mask (N,); raises :class:`BadParameter` where none would be left."""
    if not keep.any():
        raise BadParameter(
            f"{recording.name}: the remedy would drop every sample of {target}; leave it out (--skip CODE)"
        )
    note = f"{len(keep) - int(keep.sum())} of {len(keep)} samples dropped"
    stream = getattr(recording, target)
    return _replace_stream(recording, target, _select_rows(stream, keep, stream.t_ns)), note


def _select_rows(stream: Imu | Mag | Truth, keep: np.ndarray, t_ns: Times) -> Imu | Mag | Truth:
    """Return the rows of a stream that a mask (N,) keeps, at other stamps (N,)."""
    columns = {name: value[keep] for name, value in vars(stream).items() if isinstance(value, np.ndarray)}
    return replace(stream, **(columns | {"t_ns": t_ns[keep]}))


def _interpolate_held(recording: Recording, remedy: Remedy) -> tuple[Recording, str]:
    """Replace values that repeat the one before by a line between their neighbours."""
    imu, values = recording.require_imu(), _get_values(recording, remedy.target)
    held = find_repeats(values)
    seconds = (imu.t_ns - imu.t_ns[0]) / 1e9
    filled = np.stack([np.interp(seconds, seconds[~held], column[~held]) for column in values.T], axis=1)
    return _replace_values(recording, remedy.target, filled), f"{int(held.sum())} samples interpolated"


def _drop_stream(recording: Recording, remedy: Remedy) -> tuple[Recording, str]:
    return _replace_stream(recording, remedy.target, None), ""


def _conjugate_truth(recording: Recording, remedy: Remedy) -> tuple[Recording, str]:
    """Replace the attitudes of the truth by their inverses."""
    assert recording.truth is not None
    return replace(recording, truth=replace(recording.truth, q_nb=recording.truth.q_nb * [1.0, -1.0, -1.0, -1.0])), ""


def _reorder_truth(recording: Recording, remedy: Remedy) -> tuple[Recording, str]:
    """Read the components of the truth's quaternions as xyzw."""
    assert recording.truth is not None
    return replace(recording, truth=replace(recording.truth, q_nb=from_xyzw(recording.truth.q_nb))), ""


def _reorder_truth_back(recording: Recording, remedy: Remedy) -> tuple[Recording, str]:
    """Read the components of the truth's quaternions as wxyz where they were taken for xyzw."""
    assert recording.truth is not None
    return replace(recording, truth=replace(recording.truth, q_nb=to_xyzw(recording.truth.q_nb))), ""


def _turn_world(recording: Recording, remedy: Remedy) -> tuple[Recording, str]:
    """Turn the world of the truth, attitudes and positions, by the remedy's matrix."""
    truth = recording.truth
    assert truth is not None
    turn = Rotation.from_matrix(np.reshape(remedy.values, (3, 3)))
    position = None if truth.position_n_m is None else truth.position_n_m @ turn.as_matrix().T
    changed = replace(truth, q_nb=quaternion(turn * rotation(truth.q_nb)), position_n_m=position)
    return replace(recording, truth=changed), ""


def _mirror_axis(recording: Recording, remedy: Remedy) -> tuple[Recording, str]:
    """Mirror one axis of the truth's world: attitudes and positions."""
    truth = recording.truth
    assert truth is not None
    signs = np.ones(3)
    signs[int(remedy.values[0])] = -1.0
    position = None if truth.position_n_m is None else truth.position_n_m * signs
    changed = replace(truth, q_nb=truth.q_nb * np.concatenate([[1.0], -signs]), position_n_m=position)
    return replace(recording, truth=changed), ""


_KINDS: dict[str, Callable[[Recording, Remedy], tuple[Recording, str]]] = {
    "matrix": _multiply,
    "offset": _subtract_offset,
    "shift": _shift_stream,
    "line": _straighten_stamps,
    "drop": _drop_spans,
    "drop-repeats": _drop_repeats,
    "interpolate": _interpolate_held,
    "drop-stream": _drop_stream,
    "conjugate": _conjugate_truth,
    "reorder": _reorder_truth,
    "reorder-back": _reorder_truth_back,
    "world": _turn_world,
    "mirror": _mirror_axis,
}
