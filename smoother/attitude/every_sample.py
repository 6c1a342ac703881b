"""From states to samples: the calibrated gyro between keys, the remaining difference spread: paper 002 at key scale."""

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.quaternion import Quaternion, conjugate, exp, log, multiply
from stillpoint.datasets.recording import Floats, Times
from stillpoint.smoother.attitude.keys import Keys

COVARIANCE_STEP_S = 0.3


@compiled
def between_keys(key_rows: Times, key_q_nb: Floats, rate_b_radps: Floats, dt_s: Floats) -> Floats:
    """Attitude (N, 4) of every sample.

    ``key_rows`` (n,) rising, from the first sample to the last; ``key_q_nb`` (n, 4); ``rate_b_radps`` (N, 3) corrected;
    ``dt_s`` (N,). From each key the gyro is integrated to the next; what then remains to that key's attitude is given
    back in proportion to time, so that every key is met exactly.
    """
    q_nb = np.empty((len(dt_s), 4))
    for i in range(len(key_rows) - 1):
        first, last = key_rows[i], key_rows[i + 1]
        q = (key_q_nb[i, 0], key_q_nb[i, 1], key_q_nb[i, 2], key_q_nb[i, 3])
        _put(q_nb, first, q)
        span_s = 0.0
        for k in range(first + 1, last + 1):
            a, b, c = rate_b_radps[k, 0] * dt_s[k], rate_b_radps[k, 1] * dt_s[k], rate_b_radps[k, 2] * dt_s[k]
            q = multiply(q, exp((a, b, c)))
            _put(q_nb, k, q)
            span_s += dt_s[k]
        end = (key_q_nb[i + 1, 0], key_q_nb[i + 1, 1], key_q_nb[i + 1, 2], key_q_nb[i + 1, 3])
        a, b, c = log(multiply(conjugate(q), end))
        elapsed_s = 0.0
        for k in range(first + 1, last + 1):
            elapsed_s += dt_s[k]
            share = elapsed_s / span_s
            q = (q_nb[k, 0], q_nb[k, 1], q_nb[k, 2], q_nb[k, 3])
            _put(q_nb, k, multiply(q, exp((a * share, b * share, c * share))))
    _put(q_nb, key_rows[-1], (key_q_nb[-1, 0], key_q_nb[-1, 1], key_q_nb[-1, 2], key_q_nb[-1, 3]))
    return q_nb


@compiled
def _put(q_nb: Floats, k: int, q: Quaternion) -> None:
    norm = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for axis in range(4):
        q_nb[k, axis] = q[axis] / norm


def states_with_covariance(keys: Keys) -> NDArray[np.int64]:
    """Some of the window's states: it takes long to find a covariance, and from state to state it hardly changes.

    One in COVARIANCE_STEP_S, the window's first and last, those beside gaps and at the ends of rests.
    """
    states = np.array(keys.held)
    gap = keys.intervals(keys.gap)
    rest_end = keys.intervals(np.diff(keys.at_rest, append=keys.at_rest[-1:])) + 1
    cell = np.floor(keys.t_s[states] / COVARIANCE_STEP_S)
    regular = states[np.flatnonzero(np.diff(cell, prepend=-1.0))]
    return np.unique(np.concatenate([regular, states[[0, -1]], gap, gap + 1, rest_end]))


def covariance_between(t_s: Floats, q_nb: Floats, key_t_s: Floats, key_cov_b_rad2: Floats, key_q_nb: Floats) -> Floats:
    """Covariance (N, 3, 3) in body axes at attitudes ``q_nb`` (N, 4): linear in time between keys, in the axes of n.

    ``key_cov_b_rad2`` (m, 3, 3) at attitudes ``key_q_nb`` (m, 4).
    """
    turn = rotation(key_q_nb).as_matrix()
    key_cov_n = turn @ key_cov_b_rad2 @ turn.transpose(0, 2, 1)
    right = np.clip(np.searchsorted(key_t_s, t_s, side="right"), 1, len(key_t_s) - 1)
    left = right - 1
    share = (t_s - key_t_s[left]) / (key_t_s[right] - key_t_s[left])
    covariance_n = (1 - share)[:, None, None] * key_cov_n[left] + share[:, None, None] * key_cov_n[right]
    turn = rotation(q_nb).as_matrix()
    return np.asarray(turn.transpose(0, 2, 1) @ covariance_n @ turn)
