"""Simulated recordings changed in a known way; the truth is changed with them."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Recording
from stillpoint.datasets.frames import quaternion, rotation
from stillpoint.datasets.recording import Imu, Mag, Truth


def rotated_body(recording: Recording, turn: Rotation) -> Recording:
    """The same motion by a sensor whose axes are turned: v_b' = turn v_b."""
    imu, mag, truth = recording.imu, recording.mag, recording.truth
    back = turn.inv()
    base = None if recording.base_pose is None else quaternion(rotation(recording.base_pose) * back)
    return replace(
        recording,
        imu=Imu(imu.t_ns, turn.apply(imu.gyro_b_radps.copy()), turn.apply(imu.accel_b_mps2.copy())),
        mag=None if mag is None else Mag(mag.t_ns, turn.apply(mag.mag_b_ut.copy())),
        truth=replace(truth, q_nb=quaternion(rotation(truth.q_nb) * back)),
        base_pose=base,
    )


def later(recording: Recording, shift_ns: int) -> Recording:
    """The same at another time."""
    streams = {
        name: replace(getattr(recording, name), t_ns=getattr(recording, name).t_ns + shift_ns)
        for name in ("imu", "mag", "truth")
        if getattr(recording, name) is not None
    }
    return replace(recording, **streams)


def without(recording: Recording, first_s: float, last_s: float) -> Recording:
    """Samples from ``first_s`` to ``last_s`` after the start are missing; truth stays."""
    return _rows(recording, lambda t_s: (t_s < first_s) | (t_s > last_s))


def between(recording: Recording, first_s: float, last_s: float) -> Recording:
    """Only that, without base pose and with truth cut alike."""
    t_ns = recording.truth.t_ns
    t_s = (t_ns - recording.imu.t_ns[0]) / 1e9
    keep = (t_s >= first_s) & (t_s <= last_s)
    truth = Truth(t_ns[keep], recording.truth.q_nb[keep], recording.truth.moving[keep])
    cut = _rows(recording, lambda t: (t >= first_s) & (t <= last_s))
    return replace(cut, truth=truth, base_pose=None)


def turned_at_rest(recording: Recording, at_s: float, angle_rad: float, within_s: float) -> Recording:
    """From ``at_s`` on everything happens turned about the vertical: what follows is no return to the base pose."""
    imu, mag, truth = recording.imu, recording.mag, recording.truth
    t_s, mag_s = (imu.t_ns - imu.t_ns[0]) / 1e9, (mag.t_ns - imu.t_ns[0]) / 1e9
    angle, mag_angle = (angle_rad * np.clip((t - at_s) / within_s, 0, 1) for t in (t_s, mag_s))
    up_b = rotation(truth.q_nb).inv().apply([0.0, 0.0, 1.0])
    pushed = np.diff(angle, prepend=0.0) / np.diff(t_s, prepend=-0.01)
    q_mag = rotation(truth.q_nb[np.clip(np.searchsorted(truth.t_ns, mag.t_ns), 0, len(t_s) - 1)])
    field_n = q_mag.apply(mag.mag_b_ut.copy())
    about_up = Rotation.from_rotvec(np.outer(angle, [0.0, 0.0, 1.0]))
    seen = (Rotation.from_rotvec(np.outer(mag_angle, [0.0, 0.0, 1.0])) * q_mag).inv().apply(field_n)
    return replace(
        recording,
        imu=replace(imu, gyro_b_radps=imu.gyro_b_radps + pushed[:, None] * up_b),
        mag=replace(mag, mag_b_ut=seen),
        truth=replace(truth, q_nb=quaternion(about_up * rotation(truth.q_nb))),
    )


def _rows(recording: Recording, keep) -> Recording:
    imu, mag = recording.imu, recording.mag
    rows = keep((imu.t_ns - imu.t_ns[0]) / 1e9)
    cut = replace(recording, imu=Imu(imu.t_ns[rows], imu.gyro_b_radps[rows], imu.accel_b_mps2[rows]))
    if mag is None:
        return cut
    rows = keep((mag.t_ns - imu.t_ns[0]) / 1e9)
    return replace(cut, mag=Mag(mag.t_ns[rows], mag.mag_b_ut[rows]))
