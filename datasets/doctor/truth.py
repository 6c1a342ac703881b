"""The truth beside the sensors: its rate against the gyro's, its positions against the force, and its own defects."""

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.doctor.finding import Finding, Remedy
from stillpoint.datasets.doctor.lag import REACH_S, Lag, find_lag
from stillpoint.datasets.doctor.remedy import find_repeats
from stillpoint.datasets.doctor.turning import find_large_sizes, make_gyro_series, make_vector_series, solve
from stillpoint.datasets.doctor.witness import CANDIDATES, Witness, choose, find_index
from stillpoint.datasets.frames import compose, rotation
from stillpoint.datasets.recording import Floats, Imu, Recording, Truth

_RATE_WINDOW_S = 0.04
_FORCE_WINDOW_S = 0.06  # half of the span of the second difference of the positions
FEWEST = 50
_HELD_RADPS = np.deg2rad(5.0)  # faster than any bias leaves the median
_FROZEN_S, _FEWEST_HELD = 0.3, 5
_SLIP_WINDOW_S = 1.0
_SLIP_RAD, _SLIP_RATIO, _MOST_SLIPS = np.deg2rad(10.0), 10.0, 0.3  # a second that parts by less spoils no score


def ask_truth(imu: Imu, truth: Truth) -> Witness:
    """Find axes, scale, bias and lag of the gyro by the rate of an independent attitude."""
    origin = int(imu.t_ns[0])
    gyro = make_gyro_series(imu, origin)
    start, end, rate = compute_truth_rates(truth, origin)
    inside = (start - REACH_S > gyro.t_s[0]) & (end + REACH_S < gyro.t_s[-1])
    inside &= ~gyro.find_spans_in_gaps(start - REACH_S, end + REACH_S)
    start, end, rate = start[inside], end[inside], rate[inside]
    if len(start) < FEWEST:
        return Witness("truth", None)
    known = np.hstack([rate, np.ones((len(rate), 1))])

    def average_at_lag(lag_s: float) -> Floats:
        """Return the mean rates (n, 3) of the gyro over the truth's steps if its stamps are late by this."""
        return gyro.smooth_between(start + lag_s, end + lag_s) / (end - start)[:, None]

    def compute_loss(lag_s: float) -> Floats:
        """Return the square (n,) of the mean rates that no linear map of the truth's rates explains."""
        rates = average_at_lag(lag_s)
        fit = np.linalg.lstsq(known, rates, rcond=None)[0]
        return np.asarray(((rates - known @ fit) ** 2).sum(axis=1))

    lag = find_lag(compute_loss)
    moving = find_large_sizes(np.linalg.norm(rate, axis=1))
    rates, rate = average_at_lag(lag.lag_s if lag else 0.0)[moving], rate[moving]
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
    scale = float(scales[find_index(choice.matrix)])
    bias = np.median(rates - rate @ choice.matrix / scale, axis=0)
    return Witness("truth", choice, scale, lag, bias)


def compute_truth_rates(truth: Truth, origin_ns: int) -> tuple[Floats, Floats, Floats]:
    """Start and end in s of pairs of truth samples about 40 ms apart, and the mean body rate between, (n, 3)."""
    t_s = (truth.t_ns - origin_ns) / 1e9
    if len(t_s) < FEWEST:
        return np.zeros(0), np.zeros(0), np.zeros((0, 3))
    step = float(np.median(np.diff(t_s)))
    pair = max(1, round(_RATE_WINDOW_S / step))
    first = np.arange(0, len(t_s) - pair, max(1, pair // 2))
    first = first[np.abs(t_s[first + pair] - t_s[first] - pair * step) < 0.5 * step]
    if len(first) == 0:
        return np.zeros(0), np.zeros(0), np.zeros((0, 3))
    attitude = rotation(truth.q_nb)
    turn = compose(attitude[first].inv(), attitude[first + pair]).as_rotvec()
    return t_s[first], t_s[first + pair], turn / (t_s[first + pair] - t_s[first])[:, None]


def find_accel_lag(imu: Imu, truth: Truth) -> Lag | None:
    """Return how late the accelerometer is against the truth's positions, in the same body; None without them."""
    if truth.position_n_m is None:
        return None
    origin = int(imu.t_ns[0])
    force = make_vector_series(imu.t_ns, imu.accel_b_mps2, origin)
    at_s, expected, swing = _compute_truth_forces(truth, origin)
    half = _FORCE_WINDOW_S / 2
    inside = (at_s - half - REACH_S > force.t_s[0]) & (at_s + half + REACH_S < force.t_s[-1])
    inside &= ~force.find_spans_in_gaps(at_s - half - REACH_S, at_s + half + REACH_S)
    at_s, expected, swing = at_s[inside], expected[inside], swing[inside]
    if len(at_s) < FEWEST:
        return None

    def average_at_lag(lag_s: float) -> Floats:
        """Return the mean specific force (n, 3) in the windows if its stamps are late by this."""
        return force.smooth_between(at_s - half + lag_s, at_s + half + lag_s) / _FORCE_WINDOW_S

    usual = 0.1 * STANDARD_GRAVITY_MPS2
    # The accelerometer's axes (9), the arm from the tracked point to it (3), its bias (3).
    eye = np.broadcast_to(np.eye(3), (len(at_s), 3, 3))
    axes = np.einsum("ki,nj->nkij", np.eye(3), expected).reshape(-1, 3, 9)
    columns = np.concatenate([axes, swing, eye], axis=2)

    def compute_loss(lag_s: float) -> Floats:
        """Return the robust loss (n,) of the specific force at this lag."""
        felt = average_at_lag(lag_s)
        weight = np.ones(len(felt))
        for _ in range(2):
            _, residual = solve(columns, felt, weight)
            weight = 1 / (1 + (residual / usual) ** 2) ** 2
        return np.asarray(np.log1p((residual / usual) ** 2))

    return find_lag(compute_loss)


def _compute_truth_forces(truth: Truth, origin_ns: int) -> tuple[Floats, Floats, Floats]:
    """Return times in s, specific force in body axes (n, 3), and what one metre of arm adds to it, (n, 3, 3).

    The force is gravity and the second difference of the positions; the arm's is that of the attitudes.
    """
    t_s = (truth.t_ns - origin_ns) / 1e9
    if len(t_s) < FEWEST:
        return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3))
    step = float(np.median(np.diff(t_s)))
    reach = max(1, round(_FORCE_WINDOW_S / 2 / step))
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


def average_bins(bins: NDArray[np.int64], values: Floats) -> Floats:
    """Return the mean of rows (n, k) over each run of equal bins (n,)."""
    starts = np.flatnonzero(np.diff(bins, prepend=bins[0] - 1))
    counts = np.diff(starts, append=len(bins))
    return np.asarray(np.add.reduceat(values, starts, axis=0) / counts[:, None])


def check_truth_values(recording: Recording) -> list[Finding]:
    """Report a truth that is held while the gyro turns, and one that is odometry."""
    truth, imu = recording.truth, recording.imu
    if truth is None or imu is None or len(truth.t_ns) < FEWEST or len(imu.t_ns) < FEWEST:
        return []
    return [*_check_frozen(imu, truth), *_check_odometry(recording, truth)]


def _check_frozen(imu: Imu, truth: Truth) -> list[Finding]:
    """Return the finding that the truth stands still for a while although the gyro turns."""
    away = np.linalg.norm(imu.gyro_b_radps - np.median(imu.gyro_b_radps, axis=0), axis=1)
    turning = np.concatenate([[0], np.cumsum(away > _HELD_RADPS)])
    same = find_repeats(truth.q_nb)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(np.int8), [0]])))
    first, last = np.maximum(edges[::2] - 1, 0), edges[1::2] - 1  # the sample that is held, and its last repeat
    begin, end = np.searchsorted(imu.t_ns, truth.t_ns[first]), np.searchsorted(imu.t_ns, truth.t_ns[last])
    share = (turning[end] - turning[begin]) / np.maximum(end - begin, 1)
    seconds = (truth.t_ns[last] - truth.t_ns[first]) / 1e9
    held = (seconds >= _FROZEN_S) & (last - first >= _FEWEST_HELD) & (share > 0.5)
    if not held.any():
        return []
    first, last, seconds = first[held], last[held], seconds[held]
    spans = tuple(int(t) for pair in zip(truth.t_ns[first], truth.t_ns[last], strict=True) for t in pair)
    at_s = float(truth.t_ns[first[0]] - truth.t_ns[0]) / 1e9
    message = (
        f"truth: held for {seconds.sum():.2f} s in {len(first)} stretches while the gyro turns, the first {at_s:.2f} s "
        "after its start: the tracking was lost; drop these samples"
    )
    remedy = Remedy("drop", "truth", "truth: held samples dropped", spans)
    return [Finding("truth-frozen", "error", message, remedy, {"frozen_s": float(seconds.sum()), "at_s": at_s})]


def _check_odometry(recording: Recording, truth: Truth) -> list[Finding]:
    """Return the finding that the truth is odometry, by the source's word or by roll and pitch of exactly zero."""
    noted = any("is odometry" in note and "not taken" not in note for note in recording.info.notes)
    planar = bool((np.abs(truth.q_nb[:, 1:3]) < 1e-9).all()) and bool(np.ptp(truth.q_nb[:, 3]) > 0)
    if not noted and not planar:
        return []
    why = "the source says so" if noted else "its roll and pitch are exactly zero throughout, its heading is not"
    message = f"truth: is odometry ({why}): it slips and drifts, and its errors count as errors of the estimates"
    return [Finding("truth-is-odometry", "warning", message + "; score against a reference instead")]


def check_slips(imu: Imu, truth: Truth, lag_s: float) -> list[Finding]:
    """Report seconds in which a truth that fits the gyro elsewhere turns otherwise: wheels that slip, lost markers."""
    origin = int(imu.t_ns[0])
    gyro = make_gyro_series(imu, origin)
    start, end, rate = compute_truth_rates(truth, origin)
    inside = (start + lag_s > gyro.t_s[0]) & (end + lag_s < gyro.t_s[-1])
    inside &= ~gyro.find_spans_in_gaps(start + lag_s, end + lag_s)
    start, end, rate = start[inside], end[inside], rate[inside]
    if len(start) < FEWEST:
        return []
    off = rate - gyro.smooth_between(start + lag_s, end + lag_s) / (end - start)[:, None]
    bins = np.floor(start / _SLIP_WINDOW_S).astype(np.int64)
    parted = _SLIP_WINDOW_S * np.linalg.norm(average_bins(bins, off - np.median(off, axis=0)), axis=1)
    slipped = parted > max(_SLIP_RATIO * float(np.median(parted)), _SLIP_RAD)
    if not 0 < slipped.mean() < _MOST_SLIPS:
        return []
    at_s = float(start[np.searchsorted(bins, np.unique(bins)[int(np.argmax(parted))])])
    worst_deg, total_deg = float(np.rad2deg(parted.max())), float(np.rad2deg(parted[slipped].sum()))
    message = (
        f"truth: deviates from the gyro in {int(slipped.sum())} single seconds, by {worst_deg:.0f} deg in the worst, "
        f"{at_s:.1f} s after the start, and fits it in all others: odometry that slips, or markers that were mixed up"
    )
    values = {"seconds": float(slipped.sum()), "worst_deg": worst_deg, "total_deg": total_deg, "at_s": at_s}
    return [Finding("truth-is-odometry", "warning", message + "; do not score over them", values=values)]
