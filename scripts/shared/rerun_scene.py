"""Recordings, references and estimates as columns of rerun; the name of each entity says what it holds."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.frames import euler, rotation, to_xyzw, wrap
from stillpoint.datasets.mcap.facts import Kept
from stillpoint.datasets.recording import Encoder, Floats, Recording, Times
from stillpoint.datasets.times import is_inside
from stillpoint.datasets.trajectory import Estimate, Reference, SpinReference, compute_total_sd_rad

_TIMELINE = "time"
_AXIS_LENGTH = 0.5
_ANGLES, _SD_ABOUT, _SD, _BIAS = (
    "roll pitch yaw, deg, NWU",
    "sd about east north up, deg",
    "sd, deg",
    "gyro bias, deg/s",
)
_RATE, _FORCE, _FIELD, _REST = "rate, deg/s", "specific force, m/s2", "field, uT", "at rest"
_SPIN_RATE, _SPIN_ANGLE = "spin rate, deg/s", "spin angle within a turn, deg"
_SPIN_RATE_SD, _SPIN_ANGLE_SD = "sd of spin rate, deg/s", "sd of spin angle, deg"
_SPIN_FORCE, _SPIN_GYRO = "accelerometers, m/s2", "gyros, deg/s"
_QUANTITIES = (_ANGLES, _SD_ABOUT, _SD, _BIAS, _RATE, _FORCE, _FIELD, _REST)
_SPIN_QUANTITIES = (_SPIN_RATE, _SPIN_RATE_SD, _SPIN_ANGLE, _SPIN_ANGLE_SD, _SPIN_FORCE, _SPIN_GYRO)
_LABELS = {_ANGLES: ("roll", "pitch", "yaw"), _SD_ABOUT: ("east", "north", "up"), _SD: ("",), _REST: ("",)}
_LABELS |= dict.fromkeys((_SPIN_RATE, _SPIN_RATE_SD, _SPIN_ANGLE, _SPIN_ANGLE_SD), ("",))
_AXES = ("x", "y", "z")


def open_scene(save: Path | None, things: Sequence[Kept]) -> rr.RecordingStream:
    """Return a stream into a file, or into a window of its own, laid out for these things.

    Raises :class:`BadParameter` when neither can be had.
    """
    if save is None and sys.platform == "linux" and not ({"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys()):
        raise BadParameter("view: there is no screen; write a file: --save NAME.rrd")
    scene = rr.RecordingStream("stillpoint")
    try:
        if save is None:
            beside_python = Path(sys.executable).with_name("rerun")
            rr.spawn(recording=scene, executable_path=str(beside_python) if beside_python.exists() else None)
        else:
            rr.save(save, recording=scene)
    except (OSError, RuntimeError) as error:
        reason = str(error).strip().splitlines()[0].rstrip(".")
        raise BadParameter(f"view: {reason}; without a screen, write a file: --save NAME.rrd") from None
    rr.send_blueprint(_make_layout(_list_quantities(things)), recording=scene)
    rr.log("body", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, recording=scene)
    return scene


def finish_scene(scene: rr.RecordingStream) -> None:
    """Wait until all is sent; raises :class:`BadParameter` when the window or the file does not take it."""
    try:
        scene.flush()
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[0].rstrip(".")
        raise BadParameter(f"view: {reason}; write a file instead: --save NAME.rrd") from None


def show_thing(scene: rr.RecordingStream, name: str, thing: Kept) -> None:
    """Send all columns of a thing to entities that end in its name."""
    if isinstance(thing, Recording):
        _show_recording(scene, name, thing)
        return
    if isinstance(thing, SpinReference) or thing.q_nb is None:
        _show_spin(scene, name, thing)
        return
    _show_attitude(scene, name, thing.t_ns, thing.q_nb)
    if thing.cov_b_rad2 is not None:
        _spread(scene, name, thing.t_ns, thing.q_nb, thing.cov_b_rad2)
    if thing.gyro_bias_b_radps is not None:
        _show_lines(scene, _BIAS, name, thing.t_ns, np.rad2deg(thing.gyro_bias_b_radps))
    if isinstance(thing, Reference):
        at_rest = is_inside(thing.t_ns, thing.rests_ns)
        _show_lines(scene, _REST, name, thing.t_ns, at_rest.astype(np.float64)[:, None])
        _log_returns(scene, name, thing)


def _show_recording(scene: rr.RecordingStream, name: str, recording: Recording) -> None:
    """Log the measurements, truth and shafts of a recording."""
    if recording.imu is not None:
        _show_lines(scene, _RATE, name, recording.imu.t_ns, np.rad2deg(recording.imu.gyro_b_radps))
        _show_lines(scene, _FORCE, name, recording.imu.t_ns, recording.imu.accel_b_mps2)
    if recording.mag is not None:
        _show_lines(scene, _FIELD, name, recording.mag.t_ns, recording.mag.mag_b_ut)
    if recording.truth is not None:
        _show_attitude(scene, f"{name} truth", recording.truth.t_ns, recording.truth.q_nb)
    spin = recording.spin
    if spin is not None:
        _show_lines(scene, _SPIN_FORCE, name, spin.t_ns, spin.accel_mps2)
        if spin.gyro_radps.shape[1]:
            _show_lines(scene, _SPIN_GYRO, name, spin.t_ns, np.rad2deg(spin.gyro_radps))
    for what, shaft in (("truth", recording.roll_truth), ("encoder", recording.encoder)):
        if shaft is not None:
            _show_spin(scene, f"{name} {what}", shaft)


def _show_spin(scene: rr.RecordingStream, name: str, thing: Encoder | SpinReference | Estimate) -> None:
    """Show angle and rate about the spin axis, which is x of the body, with their standard deviations."""
    columns = {
        _SPIN_ANGLE: None if thing.angle_rad is None else wrap(thing.angle_rad),
        _SPIN_RATE: thing.rate_radps,
        _SPIN_ANGLE_SD: getattr(thing, "angle_sd_rad", None),
        _SPIN_RATE_SD: getattr(thing, "rate_sd_radps", None),
    }
    for quantity, values in columns.items():
        if values is not None:
            _show_lines(scene, quantity, name, thing.t_ns, np.rad2deg(values)[:, None])
    if thing.angle_rad is not None:
        half, zero = thing.angle_rad / 2, np.zeros(len(thing.t_ns))
        _show_body(scene, name, thing.t_ns, np.column_stack([np.cos(half), np.sin(half), zero, zero]))


def _show_attitude(scene: rr.RecordingStream, name: str, t_ns: Times, q_nb: Floats) -> None:
    """Show the body, and its angles."""
    _show_body(scene, name, t_ns, q_nb)
    _show_lines(scene, _ANGLES, name, t_ns, np.rad2deg(euler(q_nb, "nwu")))


def _show_body(scene: rr.RecordingStream, name: str, t_ns: Times, q_nb: Floats) -> None:
    """Show the body as three axes that turn."""
    entity = _name_entity("body", name)
    rr.log(entity, rr.TransformAxes3D(_AXIS_LENGTH), static=True, recording=scene)
    columns = rr.Transform3D.columns(quaternion=to_xyzw(q_nb))
    rr.send_columns(entity, indexes=[_time(t_ns)], columns=columns, recording=scene)


def _spread(scene: rr.RecordingStream, name: str, t_ns: Times, q_nb: Floats, cov_b_rad2: Floats) -> None:
    """Show standard deviations about east, north and up, and of the whole."""
    turn = rotation(q_nb).as_matrix()
    variance = np.einsum("nij,njk,nik->ni", turn, cov_b_rad2, turn)
    _show_lines(scene, _SD_ABOUT, name, t_ns, np.rad2deg(np.sqrt(np.maximum(variance, 0.0))))
    _show_lines(scene, _SD, name, t_ns, np.rad2deg(compute_total_sd_rad(cov_b_rad2))[:, None])


def _show_lines(scene: rr.RecordingStream, quantity: str, name: str, t_ns: Times, values: Floats) -> None:
    """Log one line per column of values (N, k)."""
    entity = _name_entity(quantity, name)
    numbers = tuple(str(k + 1) for k in range(values.shape[1])) if quantity in (_SPIN_FORCE, _SPIN_GYRO) else _AXES
    labels = [f"{name} {axis}".strip() for axis in _LABELS.get(quantity, numbers)]
    rr.log(entity, rr.SeriesLines(names=labels), static=True, recording=scene)
    columns = rr.Scalars.columns(scalars=values.ravel()).partition(np.full(len(t_ns), values.shape[1]))
    rr.send_columns(entity, indexes=[_time(t_ns)], columns=columns, recording=scene)


def _log_returns(scene: rr.RecordingStream, name: str, reference: Reference) -> None:
    """Log the returns to the base pose as text, each at its beginning."""
    if not reference.returns:
        return
    t_ns = np.array([back.start_ns for back in reference.returns], dtype=np.int64)
    texts = [f"return {'used' if back.accepted else 'rejected'}: {back.reason}" for back in reference.returns]
    levels = ["INFO" if back.accepted else "WARN" for back in reference.returns]
    columns = rr.TextLog.columns(text=texts, level=levels)
    rr.send_columns(_name_entity("returns", name), indexes=[_time(t_ns)], columns=columns, recording=scene)


def _time(t_ns: Times) -> rr.TimeColumn:
    """Return the time axis. Stamps count from 1970, or from the source's own start, which rerun shows as 1970."""
    return rr.TimeColumn(_TIMELINE, timestamp=t_ns.astype("datetime64[ns]"))


def _name_entity(quantity: str, name: str) -> str:
    return rr.new_entity_path([quantity, name])


def _list_quantities(things: Sequence[Kept]) -> tuple[str, ...]:
    """Return what there may be a plot of: attitudes, spins, or both."""
    spins = [
        isinstance(thing, SpinReference)
        or (isinstance(thing, Estimate) and thing.q_nb is None)
        or (isinstance(thing, Recording) and thing.imu is None)
        for thing in things
    ]
    return (() if all(spins) else _QUANTITIES) + (_SPIN_QUANTITIES if any(spins) else ())


def _make_layout(quantities: Sequence[str]) -> rrb.Blueprint:
    """Return bodies and returns on the left, then one plot per quantity over the same time."""
    plots = [rrb.TimeSeriesView(name=one, origin=rr.new_entity_path([one])) for one in quantities]
    left = rrb.Vertical(
        rrb.Spatial3DView(name="bodies", origin="/body"),
        rrb.TextLogView(name="returns", origin="/returns"),
        row_shares=[3, 1],
    )
    return rrb.Blueprint(rrb.Horizontal(left, rrb.Grid(*plots, grid_columns=2), column_shares=[1, 2]))
