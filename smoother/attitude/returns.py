"""Returns to the base pose in the graph: every rest votes on one common pose, and turned rests are outvoted.

A thing that is put back on a table is level again, but may be turned by degrees. So a rest in the base pose, the base
rest included, has two factors to the common pose L: tilt and place, which repeat well, and the heading by itself, with
a heavy-tailed loss. Returns that agree outvote a turned one, and also a turned base rest. A lone return has one vote
against that of the base rest: only where gyro and magnetometer contradict it clearly, it is left out (graph.py).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from stillpoint.datasets.frames import rotation
from stillpoint.datasets.recording import Floats
from stillpoint.datasets.trajectory import BasePoseReturn
from stillpoint.smoother.attitude.params import GraphParams
from stillpoint.smoother.base_pose import BasePose, Returns

_TILT_LOSS = gtsam.noiseModel.mEstimator.Cauchy.Create(3.0)  # a return that is 3 sd off has half its weight
_UNBOUNDED_SD = 10.0  # sd in rad or m of a component that a factor does not measure
_FIRST_HEADING_SD_RAD = np.deg2rad(2.0)  # of the votes in the first solve: a drifted start value must not decide
_FIRST_KERNEL = 3.0  # of the votes in the first solve
_FIRST_TURN_LIMIT_RAD = np.deg2rad(0.5)  # the first solve ends when no state turns by more
_TILT_LIMIT_SD = 3.0  # a return whose tilt is farther off is rejected
_HEADING_LIMIT_SD = 3.0  # a return whose heading is farther off is called turned
_LONE_LIMIT = 0.9  # closing square; lone returns of 10 BROAD trials 0.03 to 0.70, turned by 2.5 deg 0.5 to 2.1


@dataclass(frozen=True, eq=False)
class Votes:
    """The rests in the base pose that lie in a stretch of states."""

    states: tuple[int, ...]  # the base rest and the accepted returns
    up_b: Floats  # (3,) up in the base pose, body axes


def with_wide_votes(params: GraphParams) -> GraphParams:
    """Return the settings for the first of two solves, in which the headings of the returns hardly count."""
    heading_sd_rad = max(params.returns.heading_sd_rad, _FIRST_HEADING_SD_RAD)
    wide = replace(params.returns, heading_sd_rad=heading_sd_rad, heading_kernel=_FIRST_KERNEL)
    return replace(params, returns=wide, turn_limit_rad=max(params.turn_limit_rad, _FIRST_TURN_LIMIT_RAD))


def vote_factors(votes: Votes, params: GraphParams) -> Iterator[gtsam.NonlinearFactor]:
    """Tie each rest in the base pose to the common pose L: tilt and place by one factor, heading by another."""
    p, along = params.returns, np.outer(votes.up_b, votes.up_b)
    tilt, heading = np.zeros((6, 6)), _UNBOUNDED_SD**2 * np.eye(6)
    tilt[:3, :3] = p.repeat_sd_rad**2 * (np.eye(3) - along) + _UNBOUNDED_SD**2 * along
    tilt[3:, 3:] = params.motion.return_position_sd_m**2 * np.eye(3)
    heading[:3, :3] = _UNBOUNDED_SD**2 * (np.eye(3) - along) + p.heading_sd_rad**2 * along
    heading_loss = gtsam.noiseModel.mEstimator.Cauchy.Create(p.heading_kernel)
    make_robust, gaussian = gtsam.noiseModel.Robust.Create, gtsam.noiseModel.Gaussian.Covariance
    for state in votes.states:
        yield gtsam.BetweenFactorPose3(L(0), X(state), gtsam.Pose3(), make_robust(_TILT_LOSS, gaussian(tilt)))
        yield gtsam.BetweenFactorPose3(L(0), X(state), gtsam.Pose3(), make_robust(heading_loss, gaussian(heading)))


def closing_error(values: gtsam.Values, state: int) -> tuple[float, Floats]:
    """Return the heading of a return against the common pose, and up (3,) in its body axes.

    That heading changes by up (d_X - d_L) with the errors d_X of the return and d_L of the common pose in body axes.
    """
    common, here = values.atPose3(L(0)).rotation(), values.atPose3(X(state)).rotation()
    up_b = here.matrix()[2]
    return float(up_b @ gtsam.Rot3.Logmap(common.between(here))), up_b


def closing_square(error_rad: float, covariance_rad2: float, params: GraphParams) -> float:
    """Return the normalised square of the heading's closing error at a return, as if the return had not been used.

    Let e be the heading of the return against the common pose, C its variance in the solution, and R the variance of
    the vote, widened by its robust weight. Without the vote the error is R/(R - C) e with variance R^2/(R - C): its
    normalised square is e^2 / (R - C).
    """
    p = params.returns
    variance = p.heading_sd_rad**2 + (error_rad / p.heading_kernel) ** 2
    return error_rad**2 / max(variance - covariance_rad2, 1e-3 * variance)


def contradicts_lone_return(closing_squares: Sequence[float]) -> bool:
    """Return whether the other data contradict the heading of a lone return, which no other return can outvote."""
    return max(closing_squares, default=0.0) > _LONE_LIMIT


def reject_lone_return(base: BasePose, returns: Returns, q_nb: Floats) -> Returns:
    """Return the verdicts without the only return, given attitudes (N, 4) that were found without it."""
    first, last = (rotation(q_nb[sum(span) // 2]) for span in ((base.start, base.end), returns.spans[0]))
    back = first.inv() * last
    heading = np.rad2deg(back.as_rotvec() @ first.as_matrix()[2])
    found = f"the other data turn it by {heading:+.2f} deg, more than they may be wrong: put back turned"
    verdicts = tuple(
        replace(each, accepted=False, reason=f"{each.reason}; {found}, not the base pose") if each.accepted else each
        for each in returns.verdicts
    )
    return Returns(verdicts, (), ())


def judge_returns_again(
    base: BasePose, returns: Returns, q_nb: Floats, common_q_nb: Floats | None, params: GraphParams
) -> tuple[BasePoseReturn, ...]:
    """Return the verdicts on all rests, given the attitudes (N, 4) of the solution and the common pose (4,).

    Each return states its heading against the common pose. A return that is tilted or turned against it is rejected.
    """
    if common_q_nb is None:
        return returns.verdicts
    common = rotation(common_q_nb)
    middles = [(base.start + base.end) // 2, *(sum(span) // 2 for span in returns.spans)]
    off_b = (common.inv() * rotation(q_nb[middles])).as_rotvec()  # (1 + R, 3)
    up_b = rotation(common_q_nb).as_matrix()[2]
    heading_rad = off_b @ up_b
    tilt_rad = np.linalg.norm(off_b - heading_rad[:, None] * up_b, axis=1)
    found = iter(zip(tilt_rad[1:].tolist(), heading_rad[1:].tolist(), strict=True))
    lone = len(returns.spans) == 1
    return tuple(
        _judge_again(verdict, *next(found), lone, params) if verdict.accepted else verdict
        for verdict in returns.verdicts
    )


def _judge_again(
    verdict: BasePoseReturn, tilt_rad: float, heading_rad: float, lone: bool, params: GraphParams
) -> BasePoseReturn:
    p = params.returns
    tilt_limit_rad, heading_limit_rad = _TILT_LIMIT_SD * p.repeat_sd_rad, _HEADING_LIMIT_SD * p.heading_sd_rad
    if tilt_rad > tilt_limit_rad:
        tilt, limit = np.rad2deg(tilt_rad), np.rad2deg(tilt_limit_rad)
        reason = f"{verdict.reason}; the other data tilt it by {tilt:.1f} deg, above {limit:.1f}: not the base pose"
        return replace(verdict, accepted=False, reason=reason)
    heading, limit = np.rad2deg(heading_rad), np.rad2deg(heading_limit_rad)
    if abs(heading_rad) > heading_limit_rad:
        found = f"the other data turn it by {heading:+.2f} deg, above {limit:.2f}"
        reason = f"{verdict.reason}; {found}: put back turned, not the base pose"
        return replace(verdict, accepted=False, reason=reason)
    test = (
        "the only return, so that magnetometer and gyro alone test its heading"
        if lone
        else f"turned by {heading:+.2f} deg"
    )
    return replace(verdict, reason=f"{verdict.reason}; {test}")
