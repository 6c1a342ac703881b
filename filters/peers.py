"""Peers: estimators of other projects through their own packages, so that a table shows where one stands.

They want a constant rate and one clock: each gets the mean interval of the recording, and at each IMU sample the newest
field so far. What that hides is in the diagnostics. Attitudes come as wxyz, body to ENU, whatever Earth a package has;
tests hold every conversion against known motions.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.resources import files
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets import BadParameter, BadRecording, Imu, Mag
from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.frames import heading_rotation, local_from_enu, quaternion, rotation
from stillpoint.datasets.recording import Floats
from stillpoint.datasets.settings import Settings, choice, degrees, number

_FIRST_S = 1.0  # of a recording: the dip of its field
_QUARTER_RAD = np.pi / 2  # from North-West-Up to East-North-Up, about up


@dataclass(frozen=True)
class VqfParams(Settings):
    """Parameters of ``vqf`` and ``offline-vqf``, as their package names them; all others keep its defaults."""

    tau_acc_s: float = number(3.0, 1e-3, 1e4, "tauAcc: time constant of the accelerometer's low pass, s")
    tau_mag_s: float = number(9.0, 1e-3, 1e4, "tauMag: time constant of the magnetometer's correction, s")
    magnetometer: bool = choice(True, "use the magnetometer where there is one (9D)")


@dataclass(frozen=True)
class MadgwickParams(Settings):
    """Parameters of ``madgwick``, with the defaults of the package ahrs."""

    gain_marg_radps: float = number(0.041, 1e-6, 100.0, "gain_marg: step of the gradient descent with a field, rad/s")
    gain_imu_radps: float = number(0.033, 1e-6, 100.0, "gain_imu: the same without, rad/s")
    magnetometer: bool = choice(True, "use the magnetometer where there is one (9D)")


@dataclass(frozen=True)
class MahonyParams(Settings):
    """Parameters of ``mahony``, with the defaults of the package ahrs."""

    k_p_radps: float = number(1.0, 1e-6, 1000.0, "k_P: proportional gain, rad/s")
    k_i_radps2: float = number(0.3, 1e-9, 1000.0, "k_I: integral gain, rad/s²")
    magnetometer: bool = choice(True, "use the magnetometer where there is one (9D)")


@dataclass(frozen=True)
class AhrsEkfParams(Settings):
    """Parameters of ``ahrs-ekf``, with the defaults of the package ahrs."""

    gyro_sd_radps: float = number(0.3, 1e-9, 100.0, "root of var_gyr: sd of the rate, rad/s")
    accel_sd: float = number(0.5, 1e-9, 100.0, "root of var_acc: sd of the direction of gravity")
    mag_sd: float = number(0.8, 1e-9, 100.0, "root of var_mag: sd of the direction of the field")
    magnetic_ref: Literal["dip", "munich"] = choice(
        "dip", "magnetic_ref: the dip of the recording's first second, or the package's default, the field of Munich"
    )
    magnetometer: bool = choice(True, "use the magnetometer where there is one (9D)")


@dataclass(frozen=True)
class FusionParams(Settings):
    """Parameters of ``fusion``, with the defaults of the package imufusion, where 0 turns a feature off."""

    gain_radps: float = number(0.5, 0.0, 100.0, "gain: weight of the feedback, rad/s")
    gyroscope_range_radps: float = degrees(0.0, 0.0, 1e4, "gyroscope_range: starts again beyond 98 % of it")
    acceleration_rejection_rad: float = degrees(0.0, 0.0, 90.0, "acceleration_rejection: leaves accelerometer out")
    magnetic_rejection_rad: float = degrees(0.0, 0.0, 90.0, "magnetic_rejection: leaves the magnetometer out")
    rejection_timeout_s: float = number(0.0, 0.0, 1e4, "rejection_timeout: takes them back after so long, s")
    bias: bool = choice(True, "the package's Bias before the AHRS, as its authors advise")
    magnetometer: bool = choice(True, "use the magnetometer where there is one (9D)")


@dataclass(frozen=True)
class RiannParams(Settings):
    """``riann`` has no parameters: its authors trained one network for all sensors and rates."""


class PeerInput(NamedTuple):
    """One recording at a constant rate."""

    interval_s: float
    gyro_b_radps: Floats  # (N, 3)
    accel_b_mps2: Floats  # (N, 3)
    mag_b_ut: Floats | None  # (N, 3)


class PeerTrack(NamedTuple):
    """The output of a peer at every sample."""

    q_nb: Floats  # (N, 4) wxyz, body to magnetic East-North-Up
    gyro_bias_b_radps: Floats | None = None  # (N, 3)
    ready: NDArray[np.bool_] | None = None  # (N,)


def at_constant_rate(imu: Imu, mag: Mag | None) -> tuple[PeerInput, dict[str, Any]]:
    """Return the samples at their mean interval, and how far that and the held field are from the truth."""
    n = len(imu.t_ns)
    since_start_s = (imu.t_ns - imu.t_ns[0]) / 1e9
    interval_s = float(since_start_s[-1]) / (n - 1) if n > 1 else 0.01
    off_s = since_start_s - interval_s * np.arange(n)
    facts: dict[str, Any] = {"interval_s": interval_s, "worst_clock_error_s": float(np.abs(off_s).max())}
    if mag is None:
        return PeerInput(interval_s, imu.gyro_b_radps, imu.accel_b_mps2, None), facts
    newest = np.searchsorted(mag.t_ns, imu.t_ns, side="right") - 1
    facts["n_before_first_mag"] = int((newest < 0).sum())  # these get the first field, from their future
    newest = np.maximum(newest, 0)
    facts["worst_mag_age_s"] = float((imu.t_ns - mag.t_ns[newest]).max()) / 1e9
    return PeerInput(interval_s, imu.gyro_b_radps, imu.accel_b_mps2, mag.mag_b_ut[newest]), facts


def vqf(data: PeerInput, params: VqfParams) -> PeerTrack:
    """Run the causal filter (``VQF.updateBatch``)."""
    peer = _package("vqf").VQF(data.interval_s, tauAcc=params.tau_acc_s, tauMag=params.tau_mag_s)
    mag = data.mag_b_ut if params.magnetometer else None
    return _track(peer.updateBatch(data.gyro_b_radps, data.accel_b_mps2, mag))


def offline_vqf(data: PeerInput, params: VqfParams) -> PeerTrack:
    """Run the smoother (``offlineVQF``), which sees the future."""
    mag = data.mag_b_ut if params.magnetometer else None
    settings = {"tauAcc": params.tau_acc_s, "tauMag": params.tau_mag_s}
    return _track(_package("vqf").offlineVQF(data.gyro_b_radps, data.accel_b_mps2, mag, data.interval_s, settings))


def madgwick(data: PeerInput, params: MadgwickParams) -> PeerTrack:
    """Run ``ahrs.filters.Madgwick``: body to North-West-Up, from specific force."""
    gains = {"gain_marg": params.gain_marg_radps, "gain_imu": params.gain_imu_radps}
    found = _ahrs("Madgwick", data, params.magnetometer, data.accel_b_mps2, gains)
    return PeerTrack(quaternion(heading_rotation(_QUARTER_RAD) * rotation(found)))


def mahony(data: PeerInput, params: MahonyParams) -> PeerTrack:
    """Run ``ahrs.filters.Mahony``: body to East-North-Up, from specific force."""
    gains = {"k_P": params.k_p_radps, "k_I": params.k_i_radps2}
    return PeerTrack(_ahrs("Mahony", data, params.magnetometer, data.accel_b_mps2, gains))


def ahrs_ekf(data: PeerInput, params: AhrsEkfParams) -> PeerTrack:
    """Run ``ahrs.filters.EKF``: body to North-East-Down, from the direction of gravity, which is down.

    Not its East-North-Up: the start there has another handedness than the measurement model, and it diverges.
    """
    sds = {"var_gyr": params.gyro_sd_radps, "var_acc": params.accel_sd, "var_mag": params.mag_sd}
    settings: dict[str, Any] = {name: sd**2 for name, sd in sds.items()} | {"frame": "NED"}
    if data.mag_b_ut is not None and params.magnetometer and params.magnetic_ref == "dip":
        settings["magnetic_ref"] = _dip_deg(data)
    found = _ahrs("EKF", data, params.magnetometer, -data.accel_b_mps2, settings)
    return PeerTrack(quaternion(local_from_enu("ned").inv() * rotation(found)))


def fusion(data: PeerInput, params: FusionParams) -> PeerTrack:
    """Run ``imufusion.Ahrs``: body to East-North-Up, in deg/s and g, single precision. Ready after its start-up."""
    package = _package("imufusion")
    settings = package.AhrsSettings(
        sample_rate=1 / data.interval_s,
        gain=params.gain_radps,
        gyroscope_range=np.rad2deg(params.gyroscope_range_radps),
        acceleration_rejection=np.rad2deg(params.acceleration_rejection_rad),
        magnetic_rejection=np.rad2deg(params.magnetic_rejection_rad),
        rejection_timeout=params.rejection_timeout_s,
    )
    settings.convention = package.CONVENTION_ENU  # as a keyword of the constructor it is ignored
    peer, bias = package.Ahrs().set_settings(settings), package.Bias()
    bias.set_settings(package.BiasSettings(sample_rate=1 / data.interval_s))
    gyro_b_degps, accel_b_g = np.rad2deg(data.gyro_b_radps), data.accel_b_mps2 / STANDARD_GRAVITY_MPS2
    mag = data.mag_b_ut if params.magnetometer else None
    n = len(gyro_b_degps)
    q_nb, offset_degps, ready = np.empty((n, 4)), np.zeros((n, 3)), np.empty(n, dtype=np.bool_)
    for k in range(n):
        gyro = gyro_b_degps[k]
        if params.bias:
            gyro = bias.update(gyro)
            offset_degps[k] = bias.get_offset()
        if mag is None:
            peer.update_no_magnetometer(gyro, accel_b_g[k])
        else:
            peer.update(gyro, accel_b_g[k], mag[k])
        q_nb[k] = peer.get_quaternion()
        ready[k] = not peer.get_flags().startup
    q_nb /= np.linalg.norm(q_nb, axis=1, keepdims=True)  # single precision is off by up to 1e-6
    return PeerTrack(q_nb, np.deg2rad(offset_degps) if params.bias else None, ready)


def riann(data: PeerInput, params: RiannParams) -> PeerTrack:
    """Run ``riann.RIANN``: body to a frame with z up, from gyro and accelerometer. Its heading has no meaning."""
    package = _package("riann.riann")
    peer = package.RIANN(str(files("riann") / "riann.onnx"))  # its own search for the file fails on Python 3.11
    found = np.asarray(peer.predict(data.accel_b_mps2, data.gyro_b_radps, 1 / data.interval_s), dtype=np.float64)
    return PeerTrack(found / np.linalg.norm(found, axis=1, keepdims=True))  # single precision


def _ahrs(name: str, data: PeerInput, magnetometer: bool, accel: Floats, settings: dict[str, Any]) -> Floats:
    """Return quaternions of one filter of the package ahrs, as it gives them."""
    peer: Callable[..., Any] = getattr(_package("ahrs").filters, name)
    mag = data.mag_b_ut if magnetometer else None
    try:
        found: Floats = peer(data.gyro_b_radps, accel, mag, frequency=1 / data.interval_s, **settings).Q
    except ValueError as error:
        raise BadRecording(
            f"ahrs {name}: refuses this recording ({' '.join(str(error).split())}); use another estimator"
        ) from error
    return found


def _dip_deg(data: PeerInput) -> float:
    """Return how far the field of the first second points below the horizon."""
    first = slice(0, max(1, round(_FIRST_S / data.interval_s)))
    assert data.mag_b_ut is not None
    up, field = data.accel_b_mps2[first], data.mag_b_ut[first]
    lengths = np.linalg.norm(up, axis=1) * np.linalg.norm(field, axis=1)
    sines = -(up * field).sum(axis=1)[lengths > 0] / lengths[lengths > 0]
    return float(np.rad2deg(np.median(np.arcsin(np.clip(sines, -1, 1))))) if len(sines) else 0.0


def _track(out: dict[str, Any]) -> PeerTrack:
    return PeerTrack(out["quat9D"] if "quat9D" in out else out["quat6D"], out["bias"])


def _package(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        package = name.partition(".")[0]
        raise BadParameter(f"the estimator needs the package {package}; pip install 'stillpoint[peers]'") from error
