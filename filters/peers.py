"""Peers: estimators of other projects through their own packages, so that a table shows where one stands.

``vqf`` (Laidig and Seel 2023) wants a constant rate and one clock: it gets the mean interval of the recording, and at
each IMU sample the newest field so far. What that hides is in the diagnostics. Attitudes come as wxyz, body to ENU.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from stillpoint.datasets import BadParameter, Imu, Mag
from stillpoint.datasets.recording import Floats
from stillpoint.datasets.settings import Settings, choice, number


@dataclass(frozen=True)
class VqfParams(Settings):
    """Parameters of ``vqf`` and ``offline-vqf``, as their package names them; all others keep its defaults."""

    tau_acc_s: float = number(3.0, 1e-3, 1e4, "tauAcc: time constant of the accelerometer's low pass, s")
    tau_mag_s: float = number(9.0, 1e-3, 1e4, "tauMag: time constant of the magnetometer's correction, s")
    magnetometer: bool = choice(True, "use the magnetometer where there is one (9D)")


class PeerInput(NamedTuple):
    """One recording at a constant rate."""

    interval_s: float
    gyro_b_radps: Floats  # (N, 3)
    accel_b_mps2: Floats  # (N, 3)
    mag_b_ut: Floats | None  # (N, 3)


class PeerTrack(NamedTuple):
    """What a peer says at every sample."""

    q_nb: Floats  # (N, 4) wxyz, body to magnetic East-North-Up
    gyro_bias_b_radps: Floats | None  # (N, 3)


def at_constant_rate(imu: Imu, mag: Mag | None) -> tuple[PeerInput, dict[str, Any]]:
    """The samples at their mean interval, and how far that and the held field are from the truth."""
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
    """The causal filter (``VQF.updateBatch``)."""
    peer = _package().VQF(data.interval_s, tauAcc=params.tau_acc_s, tauMag=params.tau_mag_s)
    mag = data.mag_b_ut if params.magnetometer else None
    return _track(peer.updateBatch(data.gyro_b_radps, data.accel_b_mps2, mag))


def offline_vqf(data: PeerInput, params: VqfParams) -> PeerTrack:
    """The smoother (``offlineVQF``): it sees the future."""
    mag = data.mag_b_ut if params.magnetometer else None
    settings = {"tauAcc": params.tau_acc_s, "tauMag": params.tau_mag_s}
    return _track(_package().offlineVQF(data.gyro_b_radps, data.accel_b_mps2, mag, data.interval_s, settings))


def _track(out: dict[str, Any]) -> PeerTrack:
    return PeerTrack(out["quat9D"] if "quat9D" in out else out["quat6D"], out["bias"])


def _package() -> Any:
    try:
        import vqf as package
    except ImportError as error:
        raise BadParameter("the estimator needs the package vqf; pip install 'stillpoint[peers]'") from error
    return package
