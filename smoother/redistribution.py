"""The rest-pose benchmark of Elmi Aziz and Mohseni Araste (2021): integrate the gyro and redistribute closing errors.

At a return the true attitude is again that of the base pose, so that the closing error of the stretch is known; it is
redistributed in proportion to time. In *body* axes, q exp(f d), a share of the final error turns with the body. But
the gyro's errors accumulate in the *earth* frame (de/dt = R_nb dw), where a share of the final error keeps its
direction, exp(f e) q: against optical truth this is 1.3 to 6 times better.

The covariance is the second moment of the remaining error r(t) = x(t) - G(t) c with G = f 1 (earth) or f R(t) R(T)'
(body).
x(t) = n0 + e(t) is the error before spreading, e the drift of :mod:`stillpoint.smoother.strapdown` with its size scaled
by the closing errors that were seen, c = n0 + e(T) - n1 the closing error, n0 and n1 how far the sensor was from the
base pose when it left and when it came back. With K = cov(x, c) cov(c)^-1,

    cov(r | c) = cov(x) - K cov(c, x) + |(K - G) c|^2 / 3.

It is relative to the base pose: an error of the base pose itself (accelerometer bias, field) is common to all samples
and not included.
"""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.frames import quaternion, rotation
from stillpoint.datasets.recording import Floats, Imu, Recording
from stillpoint.datasets.settings import Settings, number
from stillpoint.datasets.times import find_gaps
from stillpoint.datasets.trajectory import Reference
from stillpoint.smoother.base_pose import BasePose, ReturnParams, Returns, closure, find_base_pose, find_returns
from stillpoint.smoother.rest import RestParams, find_rests
from stillpoint.smoother.strapdown import (
    GyroErrors,
    Swing,
    drift_covariance,
    drift_matrices,
    last_drift_matrix,
    swing,
    unknowns_variance,
    walk_steps,
)

Axes = Literal["body", "earth"]
_METHOD_OF_AXES: dict[Axes, str] = {"body": "redistribution", "earth": "redistribution-earth"}


@dataclass(frozen=True)
class RedistributionParams(Settings):
    """Settings of the rest-pose benchmark, by step."""

    rest: RestParams = field(default_factory=RestParams)
    returns: ReturnParams = field(default_factory=ReturnParams)
    gyro: GyroErrors = field(default_factory=GyroErrors)
    prior_returns: float = number(1.0, 0.01, 100.0, "how many returns' worth of trust the sizes in gyro deserve")


def redistribution(recording: Recording, params: RedistributionParams) -> Reference:
    """Return the rest-pose benchmark with closing errors spread in body axes, as published."""
    return _redistribute_in_order(recording, params, "body")


def redistribution_earth(recording: Recording, params: RedistributionParams) -> Reference:
    """Return the rest-pose benchmark with closing errors spread in the earth frame, where they arise."""
    return _redistribute_in_order(recording, params, "earth")


def _redistribute_in_order(recording: Recording, params: RedistributionParams, axes: Axes) -> Reference:
    """Return the reference by error redistribution between returns to the base pose.

    Before the first rest and after the last return the gyro is integrated freely, and the covariance grows. Raises
    :class:`Unobservable` when the recording does not start at rest or never returns.
    """
    imu = recording.require_imu()
    rests_ns = find_rests(imu, params.rest)
    base = find_base_pose(recording, rests_ns, params.returns)
    returns = find_returns(recording, rests_ns, base, params.gyro, params.returns)
    if not returns.spans:
        raise Unobservable(_explain_no_return(recording, returns))
    scale = _drift_scale(returns, base, params)
    repeat = params.returns.repeat_sd_rad**2 * np.eye(3)

    n = len(imu.t_ns)
    q_nb = np.tile(base.q_nb, (n, 1))
    cov_n = np.tile(repeat, (n, 1, 1))
    for path in returns.swings:
        q_nb[path.rows] = spread(path, base.q_nb, axes)
        cov_n[path.rows] = spread_covariance(path, closure(path, base).as_rotvec(), scale, params, axes)
    walk_rad2 = walk_steps(imu.t_ns, params.gyro)
    for start, stop in ((base.start, 0), (returns.spans[-1][1], n - 1)):
        path = swing(imu, base.gyro_bias_b_radps, start, stop, base.q_nb, walk_rad2)
        q_nb[path.rows] = path.q_nb
        cov_n[path.rows] = repeat + scale * _free_covariance(path, params.gyro)
    return Reference(
        t_ns=imu.t_ns,
        q_nb=q_nb,
        cov_b_rad2=_rotate_to_body(cov_n, q_nb),
        gyro_bias_b_radps=np.tile(base.gyro_bias_b_radps, (n, 1)),
        method=_METHOD_OF_AXES[axes],
        name=recording.name,
        rests_ns=rests_ns,
        returns=returns.verdicts,
        diagnostics=_diagnostics(imu, base, returns, scale),
    )


def spread(path: Swing, q_end_nb: Floats, axes: Axes) -> Floats:
    """Return the attitudes (M, 4) of a swing with its closing error spread over time; it ends at ``q_end_nb``."""
    raw = rotation(path.q_nb)
    share = _share(path)
    end = rotation(q_end_nb)
    if axes == "body":
        error_b = (raw[-1].inv() * end).as_rotvec()
        return quaternion(raw * Rotation.from_rotvec(share[:, None] * error_b))
    error_n = (end * raw[-1].inv()).as_rotvec()
    return quaternion(Rotation.from_rotvec(share[:, None] * error_n) * raw)


def spread_covariance(path: Swing, closing_n: Floats, scale: float, params: RedistributionParams, axes: Axes) -> Floats:
    """Return the second moment (M, 3, 3), earth frame, of the error after spreading the closing error (3,).

    The expected miss enters with equal size in all directions: its direction is known to first order only, and closing
    errors of 10-30 deg are beyond first order.
    """
    share = _share(path)
    eye = np.eye(3)
    variance, walk_rad2 = scale * unknowns_variance(params.gyro), scale * path.walk_rad2
    repeat_rad2 = params.returns.repeat_sd_rad**2
    end_matrix, back_to_end = last_drift_matrix(path), rotation(path.q_nb[-1]).as_matrix().T
    closing_cov = (end_matrix * variance) @ end_matrix.T + (walk_rad2[-1] + 2 * repeat_rad2) * eye
    cov_n = np.empty((len(share), 3, 3))
    for rows, matrix in drift_matrices(path):
        new = (walk_rad2[rows, None, None] + repeat_rad2) * eye
        with_closing = (matrix * variance) @ end_matrix.T + new
        expected = with_closing @ np.linalg.inv(closing_cov)
        turn = eye if axes == "earth" else rotation(path.q_nb[rows]).as_matrix() @ back_to_end
        missed_n = (expected - share[rows, None, None] * turn) @ closing_n
        cov_n[rows] = (matrix * variance) @ matrix.transpose(0, 2, 1) + new - expected @ with_closing.transpose(0, 2, 1)
        cov_n[rows] += np.sum(missed_n**2, axis=1)[:, None, None] / 3 * eye
    return cov_n


def _free_covariance(path: Swing, errors: GyroErrors) -> Floats:
    """Return the covariance (M, 3, 3), earth frame, of a swing without a return."""
    variance = unknowns_variance(errors)
    cov_n = path.walk_rad2[:, None, None] * np.eye(3)
    for rows, matrix in drift_matrices(path):
        cov_n[rows] += (matrix * variance) @ matrix.transpose(0, 2, 1)
    return cov_n


def _rotate_to_body(cov_n: Floats, q_nb: Floats) -> Floats:
    """Return covariances (N, 3, 3) of a small rotation, turned from the earth frame to body axes."""
    r = rotation(q_nb).as_matrix()
    return r.transpose(0, 2, 1) @ cov_n @ r


def _share(path: Swing) -> Floats:
    """Return the share of the closing error that each sample gets, (M,): the share of time passed, 1 at the end."""
    elapsed = np.cumsum(path.dt_s)
    return elapsed / elapsed[-1]


def _drift_scale(returns: Returns, base: BasePose, params: RedistributionParams) -> float:
    """Return the factor on the drift's variance: the mean normalised square of closings, with a prior of 1."""
    repeat = 2 * params.returns.repeat_sd_rad**2 * np.eye(3)  # on leaving and on coming back
    squares = []
    for path in returns.swings:
        error_n = closure(path, base).as_rotvec()
        squares.append(float(error_n @ np.linalg.solve(drift_covariance(path, params.gyro) + repeat, error_n)))
    return (params.prior_returns + sum(squares) / 3) / (params.prior_returns + len(squares))


def _explain_no_return(recording: Recording, returns: Returns) -> str:
    message = f"{recording.name}: never returns to the base pose of its first rest"
    if not returns.verdicts:
        return f"{message} (no other rest); record again with a rest in the base pose every 20-30 s and at the end"
    nearest = min(returns.verdicts, key=lambda verdict: verdict.tilt_difference_rad)
    return (
        f"{message} ({len(returns.verdicts)} rests elsewhere, the nearest: {nearest.reason}); return to the base pose"
    )


def _diagnostics(imu: Imu, base: BasePose, returns: Returns, scale: float) -> dict[str, Any]:
    """Return facts for readers of the reference, in degrees."""
    missing = find_gaps(imu.t_ns)
    last = returns.spans[-1][1]
    return {
        "heading": base.heading,
        "closing_error_deg": [float(np.rad2deg(closure(path, base).magnitude())) for path in returns.swings],
        "stretch_s": [float(np.abs(path.dt_s).sum()) for path in returns.swings],
        "returns_accepted": len(returns.spans),
        "returns_rejected": len(returns.verdicts) - len(returns.spans),
        "drift_scale": float(np.sqrt(scale)),
        "free_before_s": float(imu.t_ns[base.start] - imu.t_ns[0]) / 1e9,
        "free_after_s": float(imu.t_ns[-1] - imu.t_ns[last]) / 1e9,
        "gaps": int(missing.sum()),
        "longest_gap_s": float(np.diff(imu.t_ns)[missing].max(initial=0)) / 1e9,
    }
