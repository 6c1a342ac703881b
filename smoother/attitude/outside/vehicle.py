"""The constraints of a wheeled vehicle: it moves along its own axis, and stands where the satellites saw it stand.

Both are options (``motion.nonholonomic``, ``motion.stops``), as they are wrong for boats, drones and a phone in a hand.
"""

from collections.abc import Iterator

import gtsam
import numpy as np
from gtsam.symbol_shorthand import V, X

from stillpoint.datasets.recording import Floats, Imu, Recording, Times
from stillpoint.smoother.attitude.outside.added import Generator, States
from stillpoint.smoother.attitude.outside.satellite import OUTAGE_S, UNDER_WAY_MPS
from stillpoint.smoother.attitude.params import GraphParams

_FORWARD_B = {"x": (1.0, 0.0, 0.0), "-x": (-1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "-y": (0.0, -1.0, 0.0)}
_ANY_TURN_RAD = 3.0  # sd of a rotation about which a factor says nothing
_CALM_S, _CALM_SHARE, _CALM_WINDOWS = 2.0, 0.1, 10
_STANDING_MPS = 0.05  # sd of the velocity where the satellites saw the vehicle stand


def vehicle_generators(params: GraphParams) -> list[Generator]:
    """Return the generators of the options that are set."""
    generators: list[Generator] = []
    if params.motion.nonholonomic:

        def nonholonomic(states: States, recording: Recording) -> Iterator[gtsam.NonlinearFactor]:
            return _nonholonomic_factors(states, params)

        generators.append(nonholonomic)
    if params.motion.stops:

        def stops(states: States, recording: Recording) -> Iterator[gtsam.NonlinearFactor]:
            return _standing_factors(states, recording)

        generators.append(stops)
    return generators


def _nonholonomic_factors(states: States, params: GraphParams) -> Iterator[gtsam.NonlinearFactor]:
    """Yield for each interval that the vehicle moved along its forward axis only, by any distance.

    The factor compares tangent vectors of SE(3), which are the mean velocity in the turning body times the interval, so
    that a bend needs no correction.
    """
    along = np.array(_FORWARD_B[params.motion.forward_axis])
    across = np.eye(3) - np.outer(along, along)
    span_s = np.diff(states.t_ns) / 1e9
    for i in np.flatnonzero(~states.gap).tolist():
        far = params.motion.velocity_sd_mps * span_s[i]
        sideways = params.motion.sideways_sd_mps * span_s[i] / np.sqrt(min(span_s[i], 1.0))
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = _ANY_TURN_RAD**2 * np.eye(3)
        covariance[3:, 3:] = far**2 * np.outer(along, along) + sideways**2 * across
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        yield gtsam.BetweenFactorPose3(X(i), X(i + 1), gtsam.Pose3(), noise)


def _standing_factors(states: States, recording: Recording) -> Iterator[gtsam.NonlinearFactor]:
    """Yield a velocity of zero at the states between two fixes that both saw the vehicle stand."""
    gps = recording.gps
    if gps is None:
        return
    known = gps.valid & np.isfinite(gps.speed_mps)
    t_ns, slow = gps.t_ns[known], gps.speed_mps[known] < UNDER_WAY_MPS
    near = np.diff(t_ns) < OUTAGE_S * 1e9
    standing = np.zeros(len(states.t_ns), dtype=np.bool_)
    for k in np.flatnonzero(slow[:-1] & slow[1:] & near):
        standing[np.searchsorted(states.t_ns, t_ns[k]) : np.searchsorted(states.t_ns, t_ns[k + 1])] = True
    noise = gtsam.noiseModel.Isotropic.Sigma(3, _STANDING_MPS)
    for i in np.flatnonzero(standing):
        yield gtsam.PriorFactorVector(V(int(i)), np.zeros(3), noise)


def calm_bias(t_s: Floats, gyro_b_radps: Floats) -> Floats | None:
    """Return the gyro bias (3,) of a vehicle without satellites: its mean rate in the calmest CALM_SHARE of the time.

    A car stands at lights, or at least drives straight. ``t_s`` (N,), ``gyro_b_radps`` (N, 3). None where the recording
    is too short for CALM_WINDOWS windows.
    """
    first = np.flatnonzero(np.diff(np.floor(t_s / _CALM_S), prepend=-1.0))
    counts = np.diff(first, append=len(t_s))[:, None]
    if len(first) < _CALM_WINDOWS:
        return None
    mean = np.add.reduceat(gyro_b_radps, first, axis=0) / counts
    square = np.add.reduceat(gyro_b_radps**2, first, axis=0) / counts
    scatter = (square - mean**2).sum(axis=1)
    calmest = np.argsort(scatter)[: max(3, int(_CALM_SHARE * len(first)))]
    return np.asarray(np.median(mean[calmest], axis=0))


def drop_rests_in_curves(rests_ns: Times, imu: Imu, change_radps: float) -> Times:
    """Return the rests (R, 2) of a vehicle without satellites, without the curves that it drove evenly.

    For seconds such a curve looks like a rest. Its mean rate differs from :func:`calm_bias` by more than
    ``change_radps``. A straight drive at even speed still looks like a rest.
    """
    bias = calm_bias((imu.t_ns - imu.t_ns[0]) / 1e9, imu.gyro_b_radps)
    if bias is None or not len(rests_ns):
        return rests_ns
    spans = np.searchsorted(imu.t_ns, rests_ns)
    rates = np.array([imu.gyro_b_radps[start : end + 1].mean(axis=0) for start, end in spans])
    return rests_ns[np.linalg.norm(rates - bias, axis=1) <= change_radps]
