"""The truth as a witness: its rate in body axes beside the gyro's, and its gravity beside the accelerometer's."""

import numpy as np

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.doctor.candidates import CANDIDATES, choose, index_of
from stillpoint.datasets.doctor.lag import REACH_S, Lag, find_lag
from stillpoint.datasets.doctor.turning import gyro_series, solve, stands_out, vector_series
from stillpoint.datasets.doctor.witness import Witness
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.recording import Floats, Imu, Truth

RATE_WINDOW_S = 0.04
FORCE_WINDOW_S = 0.06  # half of the span of the second difference of the positions
FEWEST = 50
ACCEL_GAP = 0.05  # nats a sample by which one candidate must fit better than the next


def ask_truth(imu: Imu, truth: Truth) -> Witness:
    """Axes, scale, bias and lag of the gyro by the rate of an independent attitude."""
    origin = int(imu.t_ns[0])
    gyro = gyro_series(imu, origin)
    start, end, rate = truth_rates(truth, origin)
    inside = (start - REACH_S > gyro.t_s[0]) & (end + REACH_S < gyro.t_s[-1])
    inside &= ~gyro.touches_gap(start - REACH_S, end + REACH_S)
    start, end, rate = start[inside], end[inside], rate[inside]
    if len(start) < FEWEST:
        return Witness("truth", None)
    known = np.hstack([rate, np.ones((len(rate), 1))])

    def measured(lag_s: float) -> Floats:
        return gyro.smooth_between(start + lag_s, end + lag_s) / (end - start)[:, None]

    def loss(lag_s: float) -> Floats:
        rates = measured(lag_s)
        fit = np.linalg.lstsq(known, rates, rcond=None)[0]
        return np.asarray(((rates - known @ fit) ** 2).sum(axis=1))

    lag = find_lag(loss)
    moving = stands_out(np.linalg.norm(rate, axis=1))
    rates, rate = measured(lag.lag_s if lag else 0.0)[moving], rate[moving]
    turned, target = rates - np.median(rates, axis=0), rate - np.median(rate, axis=0)
    floor = 0.02**2 * float((target**2).sum(axis=1).mean()) + 1e-300
    along = np.array([(turned @ matrix.T * target).sum() for matrix in CANDIDATES])
    scales = np.maximum(along / ((turned**2).sum() + 1e-300), 0.0)
    losses = [
        np.log(((target - scale * turned @ matrix.T) ** 2).sum(axis=1) + floor)
        for scale, matrix in zip(scales, CANDIDATES, strict=True)
    ]
    choice = choose(np.array(losses), np.log((target**2).sum(axis=1) + floor), overlap=2.0)
    if choice is None:
        return Witness("truth", None)
    scale = float(scales[index_of(choice.matrix)])
    bias = np.median(rates - rate @ choice.matrix / scale, axis=0)
    return Witness("truth", choice, scale, lag, bias)


def truth_rates(truth: Truth, origin_ns: int) -> tuple[Floats, Floats, Floats]:
    """Start and end in s of pairs of truth samples about 40 ms apart, and the mean body rate between, (n, 3)."""
    t_s = (truth.t_ns - origin_ns) / 1e9
    if len(t_s) < FEWEST:
        return np.zeros(0), np.zeros(0), np.zeros((0, 3))
    step = float(np.median(np.diff(t_s)))
    pair = max(1, round(RATE_WINDOW_S / step))
    first = np.arange(0, len(t_s) - pair, max(1, pair // 2))
    first = first[np.abs(t_s[first + pair] - t_s[first] - pair * step) < 0.5 * step]
    if len(first) == 0:
        return np.zeros(0), np.zeros(0), np.zeros((0, 3))
    attitude = rotation(truth.q_nb)
    turn = (attitude[first].inv() * attitude[first + pair]).as_rotvec()
    return t_s[first], t_s[first + pair], turn / (t_s[first + pair] - t_s[first])[:, None]


def accel_against_truth(imu: Imu, truth: Truth) -> tuple[Floats | None, Lag | None]:
    """The signed permutation that turns the accelerometer's axes into the truth's, and its lag against the truth.

    Uses the acceleration from the truth's positions where it has them, gravity alone otherwise (no lag then).
    """
    origin = int(imu.t_ns[0])
    force = vector_series(imu.t_ns, imu.accel_b_mps2, origin)
    at_s, expected, swing = truth_forces(truth, origin)
    half = FORCE_WINDOW_S / 2
    inside = (at_s - half - REACH_S > force.t_s[0]) & (at_s + half + REACH_S < force.t_s[-1])
    inside &= ~force.touches_gap(at_s - half - REACH_S, at_s + half + REACH_S)
    at_s, expected, swing = at_s[inside], expected[inside], swing[inside]
    if len(at_s) < FEWEST:
        return None, None

    def measured(lag_s: float) -> Floats:
        return force.smooth_between(at_s - half + lag_s, at_s + half + lag_s) / FORCE_WINDOW_S

    usual = 0.1 * STANDARD_GRAVITY_MPS2
    # The accelerometer's axes (9), the arm from the tracked point to it (3), its bias (3).
    eye = np.broadcast_to(np.eye(3), (len(at_s), 3, 3))
    axes = np.einsum("ki,nj->nkij", np.eye(3), expected).reshape(-1, 3, 9)
    columns = np.concatenate([axes, swing, eye], axis=2)

    def loss(lag_s: float) -> Floats:
        felt = measured(lag_s)
        weight = np.ones(len(felt))
        for _ in range(2):
            _, residual = solve(columns, felt, weight)
            weight = 1 / (1 + (residual / usual) ** 2) ** 2
        return np.asarray(np.log1p((residual / usual) ** 2))

    lag = find_lag(loss) if truth.position_n_m is not None else None
    return _accel_axes(expected, measured(lag.lag_s if lag else 0.0)), lag


def _accel_axes(expected: Floats, felt: Floats) -> Floats | None:
    """The signed permutation that takes the felt forces (n, 3) closest to the expected ones; None when several do.

    Without turning several fit the one direction of gravity; the identity is then taken where it is one of them.
    """
    felt = felt * np.median(np.linalg.norm(expected, axis=1)) / (np.median(np.linalg.norm(felt, axis=1)) + 1e-300)
    floor = (0.1 * STANDARD_GRAVITY_MPS2) ** 2
    mean = np.array([np.log(((expected - felt @ m.T) ** 2).sum(axis=1) + floor).mean() for m in CANDIDATES])
    best = int(mean.argmin())
    if np.sort(mean)[1] - mean[best] >= ACCEL_GAP:
        return np.asarray(CANDIDATES[best])
    return np.asarray(CANDIDATES[0]) if mean[0] - mean[best] < ACCEL_GAP else None


def truth_forces(truth: Truth, origin_ns: int) -> tuple[Floats, Floats, Floats]:
    """Times in s, specific force in body axes (n, 3), and what one metre of arm adds to it, (n, 3, 3).

    The force is gravity and the second difference of the positions; the arm's is that of the attitudes.
    """
    t_s = (truth.t_ns - origin_ns) / 1e9
    if len(t_s) < FEWEST:
        return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3))
    step = float(np.median(np.diff(t_s)))
    reach = max(1, round(FORCE_WINDOW_S / 2 / step))
    middle = np.arange(reach, len(t_s) - reach, max(1, reach))
    middle = middle[np.abs(t_s[middle + reach] - t_s[middle - reach] - 2 * reach * step) < 0.5 * step]
    position = np.zeros((len(t_s), 3)) if truth.position_n_m is None else truth.position_n_m
    middle = middle[np.isfinite(position[middle - reach] + position[middle] + position[middle + reach]).all(axis=1)]
    if len(middle) == 0:
        return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3))
    squared = (reach * step) ** 2
    force_n = (position[middle + reach] - 2 * position[middle] + position[middle - reach]) / squared
    force_n[:, 2] += STANDARD_GRAVITY_MPS2
    before, now, after = (rotation(truth.q_nb[middle + k * reach]).as_matrix() for k in (-1, 0, 1))
    swing = np.einsum("nji,njk->nik", now, (after - 2 * now + before) / squared)
    return t_s[middle], np.einsum("nji,nj->ni", now, force_n), swing
