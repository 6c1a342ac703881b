"""Long recordings: windows that overlap, each of which begins with all that those before it say.

    |------- window 1 -------|
                     |------- window 2 -------|        the answer goes over from one to the other
                     ^ until                           linearly in the overlap

What ends a window's past are the states before the next one's first. Their factors are linearised at the optimum and
reduced to the unknowns that both have in common (the state in between, the bias there, calibration, field and hard
iron, the base pose): a Gaussian on these with all its correlations, so that nothing is counted twice or forgotten.
A window's own answer, though, knows of the future no more than the overlap.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, H, M, V, X
from scipy.spatial.transform import Rotation

from stillpoint.datasets.frames import heading_rotation, quaternion, rotation
from stillpoint.datasets.recording import Floats
from stillpoint.datasets.trajectory import Calibration
from stillpoint.smoother.attitude.evidence import Evidence
from stillpoint.smoother.attitude.factors import steps_of_bias
from stillpoint.smoother.attitude.keys import Keys
from stillpoint.smoother.attitude.params import GraphParams, KeyParams
from stillpoint.smoother.attitude.solve import Solution, linearised


@dataclass(frozen=True, eq=False)
class Past:
    """What a window hands to the next."""

    factors: tuple[gtsam.LinearContainerFactor, ...]  # on the unknowns in common
    values: gtsam.Values  # of all that the window had
    held: range  # its states in the overlap
    base: int | None  # the state of the base pose, when it lies in the past
    gyro_bias_b_radps: Floats  # (3,) where the next begins


@dataclass(frozen=True, eq=False)
class Piece:
    """The answer at the N samples of a window; covariances as the noise sizes promise them."""

    samples: slice
    q_nb: Floats  # (N, 4)
    cov_b_rad2: Floats  # (N, 3, 3) relative to the mean heading
    gyro_bias_b_radps: Floats  # (N, 3)
    heading_rad2: float  # variance of the mean heading
    closing_squares: tuple[float, ...]
    calibration: Calibration
    late_sd_s: float  # of the accelerometer's delay
    iterations: int
    cost: float


def split(keys: Keys, params: KeyParams) -> list[tuple[int, int, int]]:
    """First state of each window, of the next one, and its end: equally long, none longer than ``window_s``."""
    n, length_s = len(keys.t_s), keys.t_s[-1] - keys.t_s[0]
    overlap_s = min(params.overlap_s, params.window_s / 2)
    count = int(np.ceil((length_s - overlap_s) / (params.window_s - overlap_s)))
    if count <= 1:
        return [(0, n, n)]
    begin_s = keys.t_s[0] + (length_s - overlap_s) / count * np.arange(count)
    first = np.append(np.searchsorted(keys.t_s, begin_s), n)
    end = np.append(np.searchsorted(keys.t_s, begin_s[1:] + overlap_s), n)
    return [(int(first[k]), int(first[k + 1]), int(end[k])) for k in range(count)]


def hand_over(
    graph: gtsam.NonlinearFactorGraph, closed: Evidence, window: Keys, solution: Solution, params: GraphParams
) -> Past:
    """The past in a nutshell: ``graph`` has the factors of ``closed``, the part of the window before the next one."""
    keys, values = closed.keys, solution.values
    until = keys.states.stop
    system, _ = linearised(graph, values, closed.measured, solution.field_scale_ut, params)
    step = int(steps_of_bias(keys, params)[until])
    base, _ = closed.return_states()
    base = base if base is not None and base < until else None
    common = [X(until), V(until), B(step), M(0)]
    common += [H(0)] if values.exists(H(0)) else []
    common += [X(base)] if base is not None else []
    _, rest = system.eliminatePartialMultifrontal(_without(solution.ordering, system, common))
    return Past(
        factors=tuple(gtsam.LinearContainerFactor(rest.at(k), values) for k in range(rest.size())),
        values=values,
        held=range(until, window.held.stop),
        base=base,
        gyro_bias_b_radps=values.atConstantBias(B(step)).gyroscope(),
    )


def _without(ordering: gtsam.Ordering, system: gtsam.GaussianFactorGraph, kept: list[int]) -> gtsam.Ordering:
    """The unknowns of the system but for those kept, in the window's order: it is good for its past, too."""
    wanted = set(system.keyVector()).difference(kept)
    shorter = gtsam.Ordering()
    for k in range(ordering.size()):
        if ordering.at(k) in wanted:
            shorter.push_back(ordering.at(k))
    return shorter


def attitudes_after(past: Past, evidence: Evidence) -> Floats:
    """The attitudes (n, 4) to start from, turned to the heading of the past where no field tells it."""
    if evidence.measured is not None:
        return evidence.q_nb
    last = past.held[-1]
    turn = rotation(evidence.q_nb[last]).inv()
    difference = quaternion(Rotation.from_matrix(past.values.atPose3(X(last)).rotation().matrix()) * turn)
    angle_rad = float(2 * np.arctan2(difference[3], difference[0]))
    return quaternion(heading_rotation(angle_rad) * rotation(evidence.q_nb))


def resume(values: gtsam.Values, past: Past, keys: Keys, params: GraphParams) -> None:
    """Where the past had an unknown of the window, that begins where the past left it."""
    before = past.values
    for i in past.held:
        values.update(X(i), before.atPose3(X(i)))
        values.update(V(i), before.atVector(V(i)))
        if before.exists(C(i)) and values.exists(C(i)):
            values.update(C(i), before.atConstantBias(C(i)))
    step = steps_of_bias(keys, params)[past.held]
    for k in range(step[0], step[-1] + 1):
        values.update(B(k), before.atConstantBias(B(k)))
    values.update(M(0), before.atVector(M(0)))
    if values.exists(H(0)):
        values.update(H(0), before.atVector(H(0)))
    if past.base is not None and past.base not in keys.held:
        values.insert(X(past.base), before.atPose3(X(past.base)))


def joined(pieces: Sequence[Piece], t_s: Floats) -> Piece:
    """One piece of all: in an overlap it goes over from one to the next linearly in time.

    The mean heading is as well known as in the best window; what another window's is worse than that is added to its
    own covariance. The calibration is the last one, which has seen all data.
    """
    if len(pieces) == 1:
        return pieces[0]
    best = min(piece.heading_rad2 for piece in pieces)
    n = len(t_s)
    q_nb, cov, bias = np.empty((n, 4)), np.empty((n, 3, 3)), np.empty((n, 3))
    done = 0
    for piece in pieces:
        here = piece.samples
        common, fresh = slice(here.start, done), slice(max(done, here.start), here.stop)
        old, new = done - here.start, slice(max(done - here.start, 0), None)
        up_b = rotation(piece.q_nb).as_matrix()[:, 2]
        cov_piece = piece.cov_b_rad2 + (piece.heading_rad2 - best) * up_b[:, :, None] * up_b[:, None, :]
        if old > 0:
            span_s = t_s[common] - t_s[here.start]
            share = (span_s / span_s[-1])[:, None]
            before = rotation(q_nb[common])
            step = (before.inv() * rotation(piece.q_nb[:old])).as_rotvec()
            q_nb[common] = quaternion(before * Rotation.from_rotvec(share * step))
            cov[common] = (1 - share[:, None]) * cov[common] + share[:, None] * cov_piece[:old]
            bias[common] = (1 - share) * bias[common] + share * piece.gyro_bias_b_radps[:old]
        q_nb[fresh], cov[fresh], bias[fresh] = piece.q_nb[new], cov_piece[new], piece.gyro_bias_b_radps[new]
        done = here.stop
    return replace(
        pieces[-1],
        samples=slice(0, n),
        q_nb=q_nb,
        cov_b_rad2=cov,
        gyro_bias_b_radps=bias,
        heading_rad2=best,
        iterations=max(piece.iterations for piece in pieces),
        cost=sum(piece.cost for piece in pieces),
    )
