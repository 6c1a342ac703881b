"""The one table of estimators: the command line, tests, sweeps, reports and documents all read it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from stillpoint.datasets.nearest import require_known
from stillpoint.datasets.recording import SpinGeometry
from stillpoint.datasets.settings import Settings
from stillpoint.filters import peers
from stillpoint.filters.complementary import complementary, fixed_gain, gyro, least_squares, moving_average, tilt
from stillpoint.filters.kalman import aekf, ekf, iekf, kf_axis
from stillpoint.filters.spin import aekf as roll_aekf
from stillpoint.filters.spin import ekf as roll_ekf
from stillpoint.filters.spin import guarded as roll_guarded
from stillpoint.filters.spin import observation as roll_observation
from stillpoint.filters.spin.noise import RollParams


@dataclass(frozen=True)
class Estimator:
    """One estimator of ours: see :mod:`stillpoint.filters.sample` for what its functions take and give."""

    summary: str
    params: type[Settings]
    coefficients: Callable[[Any, float], Any]  # (params, declination_rad)
    start: Callable[[Any], Any]
    step: Callable[[Any, Any, Any], Any]
    run: Callable[[Any, Any, Any, Any], Any]  # step over columns
    gives_bias: bool = False
    gives_cov: bool = False
    innovations: int = 0  # how many normalised innovations an output has
    is_peer: bool = False
    offline: bool = False  # True: it sees the future


@dataclass(frozen=True)
class RollEstimator:
    """One estimator of roll: see :mod:`stillpoint.filters.spin.sample` for what its functions take and give."""

    summary: str
    params: type[RollParams]
    coefficients: Callable[[Any, SpinGeometry], Any]
    start: Callable[[Any], Any]
    step: Callable[[Any, Any, Any], Any]
    run: Callable[[Any, Any, Any, Any], Any]
    innovations: int = 1
    is_peer: bool = False
    offline: bool = False


@dataclass(frozen=True)
class Peer:
    """An estimator of another project, over a whole recording at a time."""

    summary: str
    params: type[Settings]
    batch: Callable[[peers.PeerInput, Any], peers.PeerTrack]
    is_peer: bool = True
    offline: bool = False


def _ours(module: Any, summary: str, **gives: Any) -> Estimator:
    return Estimator(summary, module.Params, module.coefficients, module.start, module.step, module.run, **gives)


def _roll(module: Any, summary: str, innovations: int = 1) -> RollEstimator:
    return RollEstimator(
        summary, module.Params, module.coefficients, module.start, module.step, module.run, innovations
    )


ESTIMATORS: dict[str, Estimator | RollEstimator | Peer] = {
    "acc": _ours(tilt, "tilt and compensated heading from accelerometer and magnetometer (paper 002)"),
    "acc-ma": _ours(moving_average, "moving average of acc over 7 s (paper 002)"),
    "gyro": _ours(gyro, "integrated rate, never corrected (paper 002)"),
    "cf": _ours(complementary, "second-order complementary filter (paper 002, eq 11)", gives_bias=True),
    "kf-axis": _ours(
        kf_axis,
        "Kalman filter of angle and bias per Euler axis (paper 004)",
        gives_bias=True,
        gives_cov=True,
        innovations=3,
    ),
    "cf-fixed": _ours(fixed_gain, "PI complementary filter, fixed gains (paper 003, eq 10)", gives_bias=True),
    "cf-lse": _ours(
        least_squares,
        "PI complementary filter, least-squares gains by one-step prediction (paper 003)",
        gives_bias=True,
    ),
    "cf-lse-literal": Estimator(
        "PI complementary filter, least-squares gains by eq 22 as printed: keeps its gains (paper 003)",
        least_squares.LiteralParams,
        least_squares.literal_coefficients,
        least_squares.start,
        least_squares.step,
        least_squares.run,
        gives_bias=True,
    ),
    "ekf": _ours(
        ekf,
        "error-state (multiplicative) extended Kalman filter of attitude and gyro bias",
        gives_bias=True,
        gives_cov=True,
        innovations=3,
    ),
    "aekf": _ours(
        aekf,
        "ekf with innovation-based adaptation of its trust in sensors and model (paper 000)",
        gives_bias=True,
        gives_cov=True,
        innovations=3,
    ),
    "iekf": _ours(
        iekf,
        "right-invariant extended Kalman filter on SO(3) with gyro bias",
        gives_bias=True,
        gives_cov=True,
        innovations=3,
    ),
    "vqf": Peer("VQF of the package vqf (Laidig and Seel 2023)", peers.VqfParams, peers.vqf),
    "offline-vqf": Peer(
        "offline VQF of the package vqf: sees the future", peers.VqfParams, peers.offline_vqf, offline=True
    ),
    "madgwick": Peer("gradient descent (Madgwick 2010) of the package ahrs", peers.MadgwickParams, peers.madgwick),
    "mahony": Peer("PI filter on SO(3) (Mahony 2008) of the package ahrs", peers.MahonyParams, peers.mahony),
    "ahrs-ekf": Peer("quaternion EKF of the package ahrs", peers.AhrsEkfParams, peers.ahrs_ekf),
    "fusion": Peer("revised Madgwick of the package imufusion", peers.FusionParams, peers.fusion),
    "roll-obs": _roll(roll_observation, "roll: root of the observed square of the rate (paper 000)", innovations=0),
    "roll-ekf": _roll(roll_ekf, "roll: extended Kalman filter of the rate (paper 000, eqs 11-14)"),
    "roll-aekf": _roll(roll_aekf, "roll: adaptive extended Kalman filter of the rate (paper 000, eqs 15-23)"),
    "roll-guarded": _roll(roll_guarded, "roll: angle, rate and bias, guarded against bad samples"),
}


ATTITUDES = tuple(name for name, entry in ESTIMATORS.items() if not isinstance(entry, RollEstimator))
ROLLS = tuple(name for name in ESTIMATORS if name not in ATTITUDES)


def find(name: str) -> Estimator | RollEstimator | Peer:
    """The entry of this name; raises :class:`BadParameter` with the nearest one."""
    require_known(name, ESTIMATORS, "estimator")
    return ESTIMATORS[name]
