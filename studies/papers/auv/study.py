"""The underwater mission of Zia 2022 on simulated trials: the methods, the printed figures, and the figures found.

The paper's recordings are not public. Trials come from :mod:`stillpoint.datasets.simulate`, with waves and without.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from stillpoint.datasets.frames import euler, wrap
from stillpoint.datasets.recording import Floats, Recording
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate.auv import CASPIAN
from stillpoint.filters import estimate
from stillpoint.filters.complementary.gains import Gains, gains

SeaKind = Literal["waves", "calm"]
SEAS: tuple[SeaKind, ...] = get_args(SeaKind)
SIMULATION: dict[SeaKind, str] = {"waves": "auv-dolphin", "calm": "auv-dolphin-calm"}
SETTLED_S = 20.0  # the start does not count
LAST_S = 10.0  # over so long the heading at either end of the cruise is taken


@dataclass(frozen=True)
class Method:
    """One estimate of a mission."""

    name: str
    estimator: str
    params: Mapping[str, float] = field(default_factory=dict)
    by_course: bool = True  # False: the magnetometer as it is


ADAPTIVE, PRINTED, FIXED, KALMAN, GYRO = "adaptive CF", "CF by (22)", "fixed CF", "Kalman filter", "gyro"
RAW = "adaptive, no GPS"
METHODS = (
    Method(ADAPTIVE, "cf-lse"),
    Method(RAW, "cf-lse", by_course=False),
    Method(PRINTED, "cf-lse-literal"),
    Method(FIXED, "cf-fixed", {"kp_per_s": 0.3, "ki_per_s2": 0.01}),
    Method(KALMAN, "kf-axis"),
    Method(GYRO, "gyro", by_course=False),
)


@dataclass(frozen=True)
class Figures:
    """Errors of one estimate. "Off" is its difference to the measured angle, which tables 1 and 2 call the error."""

    roll_off_mean_deg: float
    roll_off_var_deg2: float
    pitch_off_mean_deg: float
    pitch_off_var_deg2: float
    surface_roll_rmse_deg: float  # against the truth
    below_roll_rmse_deg: float
    pitch_rmse_deg: float
    heading_after_deg: float  # error against the truth at the end of the cruise
    heading_drift_deg: float  # how far it has moved since the begin of the cruise


PRINTED_FIGURES: dict[str, dict[str, float]] = {
    ADAPTIVE: {
        "roll_off_mean_deg": 5.5062e-4,
        "roll_off_var_deg2": 0.0045,
        "pitch_off_mean_deg": -1.213e-4,
        "pitch_off_var_deg2": 4.203e-4,
        "heading_after_deg": 2.0,
    },
    KALMAN: {
        "roll_off_mean_deg": -2.0596e-5,
        "roll_off_var_deg2": 0.0003,
        "pitch_off_mean_deg": -7.7762e-6,
        "pitch_off_var_deg2": -4.2436e-5,  # printed so: a variance below 0
    },
    GYRO: {"heading_after_deg": 10.0},
}


@dataclass(frozen=True, eq=False)
class Series:
    """One mission over time; angles are roll, pitch, heading in North-East-Down, deg."""

    t_s: Floats  # (N,)
    true_deg: Floats  # (N, 3)
    measured_deg: Floats  # (N, 2) roll and pitch by eqs (5), (6)
    estimated_deg: Mapping[str, Floats]  # by method, (N, 3)
    fix_s: Floats  # (K,)
    course_deg: Floats  # (K,) of valid fixes
    gains: Mapping[str, Gains]  # of the two by least squares
    phases_s: Mapping[str, float]
    place_n_m: Floats  # (N, 3) true, from where the mission begins


@dataclass(frozen=True, eq=False)
class Trial:
    """One mission: a set of figures per method."""

    sea: SeaKind
    seed: int
    figures: Mapping[str, Figures]
    params: Mapping[str, Mapping[str, Any]]
    series: Series


def run_trial(sea: SeaKind, seed: int, online: bool = False, methods: Sequence[Method] = METHODS) -> Trial:
    """Simulate one mission and run the methods over it; online means in single precision."""
    recording = simulate(SIMULATION[sea], seed=seed)
    assert recording.truth is not None
    precision: Literal["single", "double"] = "single" if online else "double"
    estimated, params = {}, {}
    for method in methods:
        heading: Literal["gps-course", "mag"] = "gps-course" if method.by_course else "mag"
        found = estimate(recording, method.estimator, dict(method.params), precision, heading)
        assert found.q_nb is not None
        estimated[method.name] = np.rad2deg(euler(found.q_nb, "ned"))
        params[method.name] = dict(found.params)
    adapted = {
        method.name: gains(recording, method.estimator, dict(method.params), precision, "gps-course")
        for method in methods
        if method.name in (ADAPTIVE, PRINTED)
    }
    series = _make_series(recording, estimated, adapted)
    return Trial(sea, seed, {name: compute_figures(series, name) for name in estimated}, params, series)


def compute_figures(series: Series, name: str) -> Figures:
    """Compute the errors of one estimate over all samples but the first SETTLED_S seconds."""
    t, when, estimated = series.t_s, series.phases_s, series.estimated_deg[name]
    counts = t > SETTLED_S
    surface = counts & ((t < when["dive_s"]) | (t > when["surfaced_s"]))
    below = (t > when["cruise_s"]) & (t < when["ascent_s"])
    off = compute_difference_deg(estimated[:, :2], series.measured_deg)[counts]
    error = compute_difference_deg(estimated, series.true_deg)
    heading = np.unwrap(error[below, 2], period=360.0)
    first = float(heading[t[below] < when["cruise_s"] + LAST_S].mean())
    last = float(heading[t[below] > when["ascent_s"] - LAST_S].mean())
    return Figures(
        roll_off_mean_deg=float(off[:, 0].mean()),
        roll_off_var_deg2=float(off[:, 0].var()),
        pitch_off_mean_deg=float(off[:, 1].mean()),
        pitch_off_var_deg2=float(off[:, 1].var()),
        surface_roll_rmse_deg=_rms(error[surface, 0]),
        below_roll_rmse_deg=_rms(error[below, 0]),
        pitch_rmse_deg=_rms(error[counts, 1]),
        heading_after_deg=last,
        heading_drift_deg=last - first,
    )


def summarise_trials(trials: Sequence[Trial], method: str, figure: str) -> float:
    """Return the root mean square over the trials of means and heading errors, whose sign is chance; else the mean."""
    values = np.array([getattr(one.figures[method], figure) for one in trials])
    return _rms(values) if figure.endswith(("_mean_deg", "_after_deg", "_drift_deg")) else float(values.mean())


def compute_difference_deg(angle_deg: Floats, other_deg: Floats) -> Floats:
    """Return the difference of two angles, within +-180 deg."""
    return np.rad2deg(wrap(np.deg2rad(angle_deg - other_deg)))


def compute_measured_deg(recording: Recording) -> Floats:
    """Return roll and pitch (N, 2) by eqs (5), (6) from the specific force of a forward-right-down body."""
    x, y, z = recording.require_imu().accel_b_mps2.T
    return np.rad2deg(np.column_stack([np.arctan2(-y, -z), np.arctan2(x, np.hypot(y, z))]))


def _make_series(recording: Recording, estimated: Mapping[str, Floats], adapted: Mapping[str, Gains]) -> Series:
    t_ns, gps, truth = recording.require_imu().t_ns, recording.gps, recording.truth
    assert gps is not None
    assert truth is not None
    assert truth.position_n_m is not None
    start_ns = CASPIAN.start_ns
    true_rad = np.unwrap(euler(truth.q_nb, "ned"), axis=0)
    at_imu = np.column_stack([np.interp(t_ns, truth.t_ns, angle) for angle in true_rad.T])
    return Series(
        t_s=(t_ns - start_ns) / 1e9,
        true_deg=np.rad2deg(wrap(at_imu)),
        measured_deg=compute_measured_deg(recording),
        estimated_deg=estimated,
        fix_s=(gps.t_ns[gps.valid] - start_ns) / 1e9,
        course_deg=np.rad2deg(wrap(gps.course_rad[gps.valid])),
        gains=adapted,
        phases_s=json.loads(recording.info.extra["phases_s"]),
        place_n_m=np.column_stack([np.interp(t_ns, truth.t_ns, part) for part in truth.position_n_m.T]),
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
