"""The servo bench of Byambajav et al., simulated or recorded: roll and heading by single sensors and ``kf-axis``."""

import json
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.signal import savgol_filter

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.errors import BadRecording
from stillpoint.datasets.frames import euler, wrap
from stillpoint.datasets.recording import Floats, Imu, Recording, Truth
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate.servo import ULAANBAATAR
from stillpoint.datasets.trajectory import Reference
from stillpoint.filters import estimate
from stillpoint.smoother import attitude_reference
from stillpoint.studies.papers.auv.study import compute_difference_deg

GYRO, ACC, KALMAN = "gyro", "accelerometer", "kf-axis"
PRINTED_DRIFT_DEG = -50.0  # the paper's text to fig 5, after a minute
_MINUTE_S = 60.0
_SHORTEST_SWING_S = 15.0
_SAME_RATE = 1.5  # swings whose rates differ by less are of one rate


@dataclass(frozen=True, eq=False)
class Series:
    """Sensors and angles of one bench over time."""

    t_s: Floats  # (N,) from the start of the motion
    gyro_b_degps: Floats  # (N, 3)
    accel_b_g: Floats  # (N, 3)
    mag_t_s: Floats  # (M,)
    mag_b_ut: Floats  # (M, 3)
    true_roll_deg: Floats  # (N,) of the judge
    roll_deg: dict[str, Floats]  # method -> (N,)
    heading_off_deg: dict[str, Floats]  # method -> (N,) less the true heading
    rests_s: Floats  # (R, 2)
    swings_hz: Floats  # (R - 1,) LOW or HIGH of the bench, 0 for a stretch without swings

    @property
    def low_hz(self) -> float:
        """Return the lower rate of the swings."""
        return float(self.swings_hz[self.swings_hz > 0].min())

    @property
    def high_hz(self) -> float:
        """Return the higher rate of the swings; the lower one where there is only one."""
        return float(self.swings_hz.max())


@dataclass(frozen=True)
class Figures:
    """Errors of one trial; the paper describes them in words."""

    drift_deg: float  # of the gyro's roll over the first minute of swings
    worst_drift_deg: float  # of any body axis in a minute, by the biases of this unit
    acc_rest_deg: float  # rms errors of roll: at rest, at the low rate, at the high one
    acc_low_deg: float
    acc_high_deg: float
    kf_rest_deg: float
    kf_low_deg: float
    kf_high_deg: float
    acc_heading_rest_deg: float  # of heading, levelled by the accelerometer's tilt, then by the filter's (6), (7)
    acc_heading_low_deg: float
    acc_heading_high_deg: float
    kf_heading_rest_deg: float
    kf_heading_low_deg: float
    kf_heading_high_deg: float


@dataclass(frozen=True, eq=False)
class Trial:
    """One bench, scored against one judge."""

    name: str  # of the recording
    judge: str  # "truth", "benchmark" or "graph"
    series: Series
    figures: Figures


def run_trial(seed: int, minutes: float) -> Trial:
    """Simulate one bench and run the methods; raises :class:`BadParameter` when ``minutes`` are too few."""
    recording = simulate("servo-bench", seed=seed, minutes=minutes)
    assert recording.truth is not None
    rests_s, swings_hz = (np.array(json.loads(recording.info.extra[name])) for name in ("rests_s", "swings_hz"))
    series = _make_series(recording, recording.truth, ULAANBAATAR.start_ns, rests_s, swings_hz)
    bias_b = json.loads(recording.info.extra["sensor_drawn"])["gyro"]["bias"]
    worst_deg = float(np.abs(np.rad2deg(bias_b)).max()) * _MINUTE_S
    return Trial(recording.name, "truth", series, _compute_figures(series, worst_deg))


def score_recording(recording: Recording) -> list[Trial]:
    """Return one trial for each judge: error redistribution, graph, and the truth where the recording has one.

    Swings are the stretches between the rests of the benchmark; each counts as of the lowest or of the highest rate.
    Raises :class:`BadRecording` where nothing swings for a minute or no field was recorded, and :class:`Unobservable`
    where the board never returns to its first pose.
    """
    if recording.mag is None:
        raise BadRecording(f"{recording.name}: has no magnetometer, which the heading needs; record one")
    blind = replace(recording, base_pose=None, truth=None)
    judges: dict[str, Truth | Reference] = {
        "benchmark": attitude_reference(blind, "redistribution"),
        "graph": attitude_reference(blind, "graph"),
    }
    if recording.truth is not None:
        judges["truth"] = recording.truth
    imu, benchmark = recording.require_imu(), judges["benchmark"]
    assert isinstance(benchmark, Reference)
    rests_s = (benchmark.rests_ns - imu.t_ns[0]) / 1e9
    swings_hz = _measure_swings_hz(imu, rests_s, recording.name)
    trials = []
    for judge, truth in judges.items():
        series = _make_series(blind, truth, int(imu.t_ns[0]), rests_s, swings_hz)
        at_rest = np.rad2deg(imu.gyro_b_radps[select_swings(series, None)].mean(axis=0))
        trials.append(
            Trial(recording.name, judge, series, _compute_figures(series, float(np.abs(at_rest).max()) * _MINUTE_S))
        )
    return trials


def select_swings(series: Series, rate_hz: float | None) -> NDArray[np.bool_]:
    """Return which samples (N,) lie in the swings at this rate; for None those at rest, without the first seconds."""
    inside = np.zeros(len(series.t_s), dtype=np.bool_)
    if rate_hz is None:
        for start, end in series.rests_s:
            inside |= (series.t_s > max(start, 2.0)) & (series.t_s < end)
        return inside
    for k in np.flatnonzero(series.swings_hz == rate_hz):
        inside |= (series.t_s > series.rests_s[k, 1]) & (series.t_s < series.rests_s[k + 1, 0])
    return inside


def find_first_swing_s(series: Series, rate_hz: float) -> tuple[float, float]:
    """Return begin and end of the first swing at this rate."""
    k = int(np.flatnonzero(series.swings_hz == rate_hz)[0])
    return float(series.rests_s[k, 1]), float(series.rests_s[k + 1, 0])


def restart_at(series: Series, method: str, start_s: float) -> Floats:
    """Return a method's roll, shifted so that it agrees with the true roll at a time, like an integral from there."""
    off = compute_difference_deg(series.roll_deg[method], series.true_roll_deg)
    start = int(np.searchsorted(series.t_s, start_s))
    return np.asarray(series.true_roll_deg + np.unwrap(off, period=360.0) - off[start])


def _measure_swings_hz(imu: Imu, rests_s: Floats, name: str) -> Floats:
    """Return the rate of the swings after each rest but the last: the lowest or the highest of all, 0 for too short."""
    t_s, rate = (imu.t_ns - imu.t_ns[0]) / 1e9, imu.gyro_b_radps[:, 0]
    found = np.zeros(len(rests_s) - 1)
    for k, (start, end) in enumerate(zip(rests_s[:-1, 1], rests_s[1:, 0], strict=True)):
        inside = slice(*np.searchsorted(t_s, (start, end)))
        if end - start >= _SHORTEST_SWING_S:
            smooth = savgol_filter(rate[inside], 11, 2)
            found[k] = np.count_nonzero(np.diff(np.sign(smooth - smooth.mean()))) / 2 / (end - start)
    if not found.any():
        raise BadRecording(
            f"{name}: does not swing about x for {_SHORTEST_SWING_S:g} s between two rests; record longer swings"
        )
    low, high = found[found > 0].min(), found.max()
    nearest = np.where(found < np.sqrt(low * high), low, high) if high > _SAME_RATE * low else np.full_like(found, low)
    return np.where(found > 0, nearest, 0.0)


def _make_series(
    recording: Recording, judge: Truth | Reference, start_ns: int, rests_s: Floats, swings_hz: Floats
) -> Series:
    """Return what the figures draw, on the IMU's stamps; angles in deg, rates in deg/s, forces in g."""
    imu, mag = recording.require_imu(), recording.mag
    assert mag is not None
    t_s = (imu.t_ns - start_ns) / 1e9
    true_roll_deg, true_yaw_deg = (
        np.rad2deg(wrap(np.interp(imu.t_ns, judge.t_ns, np.unwrap(np.deg2rad(angle)))))
        for angle in _compute_euler_deg(judge.q_nb)[[0, 2]]
    )
    estimates = {ACC: estimate(recording, "acc", {"kappa": 1.0}), KALMAN: estimate(recording, "kf-axis")}
    angles = {name: _compute_euler_deg(found.q_nb) for name, found in estimates.items() if found.q_nb is not None}
    # The paper integrates the rate about one axis by (13), so a bias about another axis has no effect.
    turned_rad = cumulative_trapezoid(imu.gyro_b_radps[:, 0], t_s, initial=0)
    rolls = {name: roll_deg for name, (roll_deg, _, _) in angles.items()}
    return Series(
        t_s=t_s,
        gyro_b_degps=np.rad2deg(imu.gyro_b_radps),
        accel_b_g=imu.accel_b_mps2 / STANDARD_GRAVITY_MPS2,
        mag_t_s=(mag.t_ns - start_ns) / 1e9,
        mag_b_ut=mag.mag_b_ut,
        true_roll_deg=true_roll_deg,
        roll_deg={**rolls, GYRO: true_roll_deg[0] + np.rad2deg(turned_rad)},
        heading_off_deg={
            name: compute_difference_deg(yaw_deg, true_yaw_deg) for name, (_, _, yaw_deg) in angles.items()
        },
        rests_s=rests_s,
        swings_hz=swings_hz,
    )


def _compute_euler_deg(q_nb: Floats) -> Floats:
    """Return roll, pitch and yaw as rows (3, N)."""
    return np.asarray(np.rad2deg(euler(q_nb, "enu")).T)


def _compute_figures(series: Series, worst_drift_deg: float) -> Figures:
    """Return the drift of the gyro over a minute and the RMS errors at rest, in slow and in fast swings, in deg."""
    start, _ = find_first_swing_s(series, series.low_hz)
    minute = restart_at(series, GYRO, start) - series.true_roll_deg
    drift = float(minute[np.searchsorted(series.t_s, start + _MINUTE_S) - 1])
    stretches = {"rest": None, "low": series.low_hz, "high": series.high_hz}
    rms = {}
    for method, short in ((ACC, "acc"), (KALMAN, "kf")):
        roll_off_deg = compute_difference_deg(series.roll_deg[method], series.true_roll_deg)
        for name, rate_hz in stretches.items():
            inside = select_swings(series, rate_hz)
            rms[f"{short}_{name}_deg"] = _compute_rms(roll_off_deg[inside])
            rms[f"{short}_heading_{name}_deg"] = _compute_rms(series.heading_off_deg[method][inside])
    return Figures(drift, worst_drift_deg, **rms)


def _compute_rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
