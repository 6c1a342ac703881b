"""The underwater mission of Zia 2022 on simulated or recorded trials: methods, printed figures, and figures found.

The paper's recordings are not public. Simulated trials come from :mod:`stillpoint.datasets.simulate`, with waves and
without; there the hull's iron and the gyro's bias are inputs, so the heading errors that they make are no results.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np

from stillpoint.datasets.errors import BadRecording
from stillpoint.datasets.frames import euler, wrap
from stillpoint.datasets.recording import Floats, Recording, Truth
from stillpoint.datasets.settings import choose_settings
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate.auv import CASPIAN
from stillpoint.datasets.trajectory import Estimate, Reference
from stillpoint.filters import Stream, estimate
from stillpoint.filters.complementary.gains import Gains, gains
from stillpoint.filters.front.heading_source import Heading
from stillpoint.filters.front.sources import choose_magnetometer, find_sources, make_raw_log
from stillpoint.filters.precision import Precision
from stillpoint.filters.table import find_estimator
from stillpoint.smoother import attitude_reference

SeaKind = Literal["waves", "calm"]
SEAS: tuple[SeaKind, ...] = get_args(SeaKind)
_SIMULATION: dict[SeaKind, str] = {"waves": "auv-dolphin", "calm": "auv-dolphin-calm"}
SETTLED_S = 20.0  # the start does not count
RECORDED = "recorded"  # in place of a sea
_SHORTEST_DIVE_S = 60.0
_LAST_S = 10.0  # over so long the heading at either end of the cruise is taken


@dataclass(frozen=True)
class Method:
    """One estimate of a mission."""

    name: str
    estimator: str
    params: Mapping[str, float] = field(default_factory=dict)
    by_course: bool = True  # False: the magnetometer as it is


ADAPTIVE, PRINTED, FIXED, KALMAN, GYRO = "adaptive CF", "CF by (22)", "fixed CF", "Kalman filter", "gyro"
RAW, SURE = "adaptive, no GPS", "Kalman, R of 0.05°"
_SURE_SD_DEG = 0.05  # of R: so sure of the accelerometer the filter follows it, and its means are as small as printed
METHODS = (
    Method(ADAPTIVE, "cf-lse"),
    Method(RAW, "cf-lse", by_course=False),
    Method(PRINTED, "cf-lse-literal"),
    Method(FIXED, "cf-fixed", {"kp_per_s": 0.3, "ki_per_s2": 0.01}),
    Method(KALMAN, "kf-axis"),
    Method(SURE, "kf-axis", {"tilt_sd_rad": float(np.deg2rad(_SURE_SD_DEG))}),
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
    true_deg: Floats  # (N, 3) of the truth, or of the graph where there is none
    measured_deg: Floats  # (N, 2) roll and pitch by eqs (5), (6)
    estimated_deg: Mapping[str, Floats]  # by method, (N, 3)
    fix_s: Floats  # (K,)
    course_deg: Floats  # (K,) of valid fixes
    gains: Mapping[str, Gains]  # of the two by least squares
    phases_s: Mapping[str, float]
    place_n_m: Floats | None  # (N, 3) true, from where the mission begins


@dataclass(frozen=True, eq=False)
class Trial:
    """One mission: a set of figures per method."""

    sea: str  # a SeaKind, or RECORDED
    name: str  # of the recording
    figures: Mapping[str, Figures]
    params: Mapping[str, Mapping[str, Any]]
    series: Series


def run_trial(sea: SeaKind, seed: int, online: bool = False, methods: Sequence[Method] = METHODS) -> Trial:
    """Simulate one mission and run the methods over it; online means sample by sample in single precision."""
    recording = simulate(_SIMULATION[sea], seed=seed)
    assert recording.truth is not None
    phases_s = json.loads(recording.info.extra["phases_s"])
    return _score_methods(recording, recording.truth, sea, CASPIAN.start_ns, phases_s, online, methods)


def score_recording(recording: Recording, online: bool = False, methods: Sequence[Method] = METHODS) -> Trial:
    """Run the methods over a recorded mission; it is judged by its truth, or by the graph where it has none.

    The vehicle is under water in the longest stretch without a valid fix. Raises :class:`BadRecording` for a recording
    without satellite fixes, or whose fixes are valid throughout, :class:`Unobservable` where no graph can be made.
    """
    gps, t_ns = recording.gps, recording.require_imu().t_ns
    if gps is None or not gps.valid.any():
        raise BadRecording(f"{recording.name}: has no valid satellite fix; record fixes before and after the dive")
    valid_ns = gps.t_ns[gps.valid]
    longest = int(np.argmax(np.diff(valid_ns))) if len(valid_ns) > 1 else 0
    below_s = (valid_ns[longest : longest + 2] - t_ns[0]) / 1e9
    if len(below_s) < 2 or below_s[1] - below_s[0] < _SHORTEST_DIVE_S:
        raise BadRecording(f"{recording.name}: is never without satellites for {_SHORTEST_DIVE_S:g} s; record a dive")
    down_s, up_s = float(below_s[0]), float(below_s[1])
    end_s = float(t_ns[-1] - t_ns[0]) / 1e9
    phases_s = {"dive_s": down_s, "cruise_s": down_s, "ascent_s": up_s, "surfaced_s": up_s, "end_s": end_s}
    judge: Truth | Reference = recording.truth or attitude_reference(replace(recording, truth=None))
    return _score_methods(replace(recording, truth=None), judge, RECORDED, int(t_ns[0]), phases_s, online, methods)


def _score_methods(
    recording: Recording,
    judge: Truth | Reference,
    sea: str,
    start_ns: int,
    phases_s: Mapping[str, float],
    online: bool,
    methods: Sequence[Method],
) -> Trial:
    """Run all methods over a recording, and return their figures, settings and series."""
    precision: Precision = "single" if online else "double"
    estimated, params = {}, {}
    for method in methods:
        heading: Heading = "gps-course" if method.by_course else "mag"
        run = stream_estimate if online else estimate
        found = run(recording, method.estimator, method.params, heading=heading)
        assert found.q_nb is not None
        estimated[method.name] = np.rad2deg(euler(found.q_nb, "ned"))
        params[method.name] = dict(found.params)
    adapted = {
        method.name: gains(recording, method.estimator, dict(method.params), precision, "gps-course")
        for method in methods
        if method.name in (ADAPTIVE, PRINTED)
    }
    series = _make_series(recording, judge, estimated, adapted, start_ns, phases_s)
    figures = {name: compute_figures(series, name) for name in estimated}
    return Trial(sea, recording.name, figures, params, series)


def stream_estimate(recording: Recording, name: str, params: Mapping[str, Any], *, heading: Heading) -> Estimate:
    """Return what an estimator says when it is fed sample by sample in single precision, as on a device."""
    imu, sources = recording.require_imu(), find_sources(recording, heading, None, None)
    mag, declination_rad, facts = choose_magnetometer(recording)
    settings = choose_settings(find_estimator(name).params(), params, name)
    north_is_true = mag is not None and facts["heading"].startswith("true north")
    stream = Stream(name, settings, declination_rad if north_is_true else None, "single", heading)
    log, _ = make_raw_log(imu, sources)
    q_nb = np.empty((len(imu.t_ns), 4))
    rows = zip(log.t_ns.tolist(), log.gyro_b_radps.tolist(), log.accel_b_mps2.tolist(), strict=True)
    for k, (t_ns, gyro_b_radps, accel_b_mps2) in enumerate(rows):
        field, fix = log.mag_row[k], log.fix_row[k]
        mag_b_ut = None if field < 0 else log.mag_b_ut[field].tolist()
        course = None if fix < 0 else (float(log.course_rad[fix]), float(log.speed_mps[fix]))
        q_nb[k] = stream.update(t_ns, gyro_b_radps, accel_b_mps2, mag_b_ut, course).q_nb
    return Estimate(
        t_ns=imu.t_ns,
        name=name,
        recording=recording.name,
        q_nb=q_nb,
        params=asdict(settings),
        diagnostics={"precision": "single", "fed": "sample by sample"} | stream.counts,
    )


def compute_figures(series: Series, name: str) -> Figures:
    """Compute the errors of one estimate over all samples but the first SETTLED_S seconds."""
    t, when, estimated = series.t_s, series.phases_s, series.estimated_deg[name]
    counts = t > SETTLED_S
    surface = counts & ((t < when["dive_s"]) | (t > when["surfaced_s"]))
    below = (t > when["cruise_s"]) & (t < when["ascent_s"])
    off = compute_difference_deg(estimated[:, :2], series.measured_deg)[counts]
    error = compute_difference_deg(estimated, series.true_deg)
    heading = np.unwrap(error[below, 2], period=360.0)
    first = float(heading[t[below] < when["cruise_s"] + _LAST_S].mean())
    last = float(heading[t[below] > when["ascent_s"] - _LAST_S].mean())
    return Figures(
        roll_off_mean_deg=float(off[:, 0].mean()),
        roll_off_var_deg2=float(off[:, 0].var()),
        pitch_off_mean_deg=float(off[:, 1].mean()),
        pitch_off_var_deg2=float(off[:, 1].var()),
        surface_roll_rmse_deg=_compute_rms(error[surface, 0]),
        below_roll_rmse_deg=_compute_rms(error[below, 0]),
        pitch_rmse_deg=_compute_rms(error[counts, 1]),
        heading_after_deg=last,
        heading_drift_deg=last - first,
    )


def summarise_trials(trials: Sequence[Trial], method: str, figure: str) -> float:
    """Return the root mean square over the trials of means and heading errors, whose sign is chance; else the mean."""
    values = np.array([getattr(one.figures[method], figure) for one in trials])
    return _compute_rms(values) if figure.endswith(("_mean_deg", "_after_deg", "_drift_deg")) else float(values.mean())


def compute_difference_deg(angle_deg: Floats, other_deg: Floats) -> Floats:
    """Return the difference of two angles, within +-180 deg."""
    return np.rad2deg(wrap(np.deg2rad(angle_deg - other_deg)))


def compute_measured_deg(recording: Recording) -> Floats:
    """Return roll and pitch (N, 2) by eqs (5), (6) from the specific force of a forward-right-down body."""
    x, y, z = recording.require_imu().accel_b_mps2.T
    return np.rad2deg(np.column_stack([np.arctan2(-y, -z), np.arctan2(x, np.hypot(y, z))]))


def _make_series(
    recording: Recording,
    judge: Truth | Reference,
    estimated: Mapping[str, Floats],
    adapted: Mapping[str, Gains],
    start_ns: int,
    phases_s: Mapping[str, float],
) -> Series:
    """Return what the figures draw, on the IMU's stamps; angles in deg."""
    t_ns, gps = recording.require_imu().t_ns, recording.gps
    assert gps is not None
    true_rad = np.unwrap(euler(judge.q_nb, "ned"), axis=0)
    at_imu = np.column_stack([np.interp(t_ns, judge.t_ns, angle) for angle in true_rad.T])
    place_n_m = judge.position_n_m
    return Series(
        t_s=(t_ns - start_ns) / 1e9,
        true_deg=np.rad2deg(wrap(at_imu)),
        measured_deg=compute_measured_deg(recording),
        estimated_deg=estimated,
        fix_s=(gps.t_ns[gps.valid] - start_ns) / 1e9,
        course_deg=np.rad2deg(wrap(gps.course_rad[gps.valid])),
        gains=adapted,
        phases_s=phases_s,
        place_n_m=None
        if place_n_m is None
        else np.column_stack([np.interp(t_ns, judge.t_ns, part) for part in place_n_m.T]),
    )


def _compute_rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
