"""The three experiments of Elmi Aziz and Mohseni Araste 2021 on simulated or recorded trials, with printed figures.

The paper scores filters against a benchmark made from the same phone. A simulated trial also has its truth, so the
benchmark is scored, too; so has a recording that was made beside a motion capture.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.frames import euler, quaternion, rotation
from stillpoint.datasets.recording import Floats, Recording, Truth
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.trajectory import Estimate, Reference
from stillpoint.filters import estimate
from stillpoint.scoring.compare import compare
from stillpoint.scoring.errors import compute_attitude_error, compute_euler_error
from stillpoint.scoring.score import Score, score
from stillpoint.smoother import attitude_reference
from stillpoint.studies.papers.phone.parameters import MEAN_S, SLOWER, map_errors_deg

JudgeName = Literal["benchmark", "graph", "truth"]
JUDGES: tuple[JudgeName, ...] = get_args(JudgeName)
REFERENCES = {"benchmark": "redistribution", "graph": "graph"}
ACC, ACC_MA, GYRO, CF, KALMAN = "Acc", "Acc_MA", "Gyro", "CF", "Kalman"
CF_SLOWER, CF_LITERAL, ACC_MA_CENTRED = "CF, slower", "CF, literal", "Acc_MA, centred"
KALMAN_AXIS = "Kalman, per axis"
ESTIMATORS: dict[str, tuple[str, Mapping[str, float]]] = {
    CF: ("cf", {}),
    CF_SLOWER: ("cf", SLOWER._asdict()),
    CF_LITERAL: ("cf-literal", {}),
    ACC: ("acc", {}),
    ACC_MA: ("acc-ma", {"window_s": MEAN_S}),
    GYRO: ("gyro", {}),
    KALMAN: ("ekf", {}),
    KALMAN_AXIS: ("kf-axis", {}),
}
METHODS = (CF, CF_SLOWER, CF_LITERAL, ACC, ACC_MA, ACC_MA_CENTRED, GYRO, KALMAN, KALMAN_AXIS)
_LONG_METHODS = (CF, CF_SLOWER, KALMAN, KALMAN_AXIS)


class _KalmanGain(NamedTuple):
    """Hold the gain of the paper's Kalman filter over its CF in two hours of experiment 3 (section 4-4)."""

    tilt_deg: float
    heading_deg: float
    time_ratio: float


PRINTED_KALMAN_GAIN = _KalmanGain(0.2, 0.5, 4.0)
RECORDED = "recorded"  # how the phone of a recording is moved, in place of a simulated hand
AXES = ("roll", "pitch", "yaw")
DRIFT_S = 60.0  # fig 10 looks at the gyro after about a minute
LEAD_S = 10.0  # the paper's pictures begin so long before the first motion
RUNS = 3  # of which the fastest is timed


@dataclass(frozen=True)
class Scenario:
    """One of the three experiments."""

    name: str
    title: str
    number: int
    hands: Mapping[str, str]  # how the phone is moved -> simulation
    printed: Mapping[str, tuple[float | None, ...]]  # method -> RMSE and MaxAE of roll, pitch, yaw, as printed


@dataclass(frozen=True, eq=False)
class Series:
    """Roll, pitch, yaw (NWU, deg) over time at the IMU's stamps, seconds from LEAD_S before the first motion."""

    t_s: Floats  # (N,)
    angles_deg: Mapping[str, Floats]  # of each method and reference, (N, 3)
    errors: Mapping[str, tuple[Floats, Floats]]  # total error of each reference: s, deg; empty without a truth
    rests_s: Floats  # (R, 2)


class Folded(NamedTuple):
    """Errors of yaw taken modulo 90 deg, as the paper's largest ones (44.3, 44.97 and 44.97 deg) suggest."""

    rmse_deg: float
    maxae_deg: float


@dataclass(frozen=True)
class Trial:
    """Scores of one recording: each method against each judge, the references against each other and the truth."""

    hand: str
    name: str  # of the recording
    scores: Mapping[tuple[str, str], Score]  # (method or reference, judge)
    refused: Mapping[str, str]  # reference -> why there is none
    folded_yaw: Mapping[str, Folded]  # of each method, against the benchmark
    common_tilt_deg: Mapping[str, float]  # of a reference against the truth, in the base pose: all its samples share it
    drift_deg: tuple[float, float, float]  # the gyro's roll, pitch, yaw off the benchmark a minute after the start
    params: Mapping[str, Mapping[str, Any]]
    series: Series
    map_deg: Floats  # CF's RMSE of roll, pitch, yaw against the benchmark over its parameters (K, L, 3)
    mag_left_out: bool  # the methods did not use the magnetometer, which is not calibrated


@dataclass(frozen=True)
class LongRun:
    """Errors over the moving samples, and time per sample, of one filter over a long recording."""

    method: str
    estimator: str
    tilt_rmse_deg: float
    heading_rmse_deg: float
    ns_per_sample: float


def run_trial(scenario: Scenario, hand: str, seed: int) -> Trial:
    """Simulate one recording and score all methods on it; the references are not told its true base pose."""
    return score_trial(simulate(scenario.hands[hand], seed=seed), hand)


def score_trial(recording: Recording, hand: str = RECORDED, corrected: Recording | None = None) -> Trial:
    """Make both references of a recording and score all methods against them, and against its truth if it has one.

    The methods run on ``corrected``, the same samples as a calibrated sensor would give them, where that is given.
    Where the recording does not begin at rest or never returns to its base pose there is no benchmark; the graph then
    stands for it. Raises :class:`Unobservable` where there is no graph either, and :class:`BadRecording` where there is
    no IMU.
    """
    blind = replace(recording, base_pose=None, truth=None)
    references, refused = {}, {}
    for name, method in REFERENCES.items():
        try:
            references[name] = attitude_reference(blind, method)
        except Unobservable as error:
            refused[name] = str(error)
    if not references:
        raise Unobservable(refused["benchmark"])
    seen = blind if corrected is None else replace(corrected, base_pose=None, truth=None)
    made = _estimate_all(seen)
    things: dict[str, Estimate | Reference] = {**made, **references}
    judges: dict[str, Reference | Truth] = dict(references)
    if recording.truth is not None:
        judges["truth"] = recording.truth
    scores = {
        (method, judge): score(thing, truth, "none")
        for judge, truth in judges.items()
        for method, thing in things.items()
        if method != judge
    }
    benchmark = references.get("benchmark", references.get("graph"))
    assert benchmark is not None
    return Trial(
        hand,
        recording.name,
        scores,
        refused,
        {method: _fold_yaw(thing, benchmark) for method, thing in made.items()},
        {
            name: _measure_tilt_at_start_deg(each, recording.truth)
            for name, each in references.items()
            if recording.truth is not None
        },
        _measure_drift_deg(made[GYRO], benchmark),
        {name: dict(thing.params) for name, thing in things.items()},
        _make_series(recording.truth, benchmark, references, made),
        map_errors_deg(seen, benchmark),
        seen.info.mag_uncalibrated,
    )


def _estimate_all(recording: Recording) -> dict[str, Estimate]:
    """Return the estimates of all METHODS, by name."""
    made = {method: estimate(recording, name, params) for method, (name, params) in ESTIMATORS.items()}
    made[ACC_MA_CENTRED] = centre_mean(made[ACC_MA])
    return {method: made[method] for method in METHODS}


def centre_mean(mean: Estimate) -> Estimate:
    """Return a moving average whose values carry the stamp of the middle of their window, not of its end.

    It is late by nothing and sees the future by half a window, so no device has it while it moves.
    """
    assert mean.q_nb is not None
    assert mean.ready is not None
    t_ns = mean.t_ns - round(MEAN_S / 2 * 1e9)
    kept = t_ns >= 0  # of a clock that starts at 0
    name = f"{mean.name} centred"
    return replace(mean, t_ns=t_ns[kept], q_nb=mean.q_nb[kept], ready=mean.ready[kept], name=name)


def _measure_drift_deg(gyro: Estimate, benchmark: Reference) -> tuple[float, float, float]:
    """Return the gyro's error in roll, pitch, yaw, DRIFT_S after it was set to the benchmark at the start of motion."""
    assert gyro.q_nb is not None
    start = _find_first_motion(benchmark)
    end = int(np.searchsorted(benchmark.t_ns, benchmark.t_ns[start] + round(DRIFT_S * 1e9), side="right")) - 1
    restarted = restart_integration(gyro.q_nb, benchmark.q_nb, start)
    roll, pitch, yaw = np.rad2deg(compute_euler_error(restarted[[end]], benchmark.q_nb[[end]], "nwu")[0])
    return float(roll), float(pitch), float(yaw)


def _find_first_motion(benchmark: Reference) -> int:
    """Return the sample at which the first rest of a reference ends; 0 where it has none."""
    return int(np.searchsorted(benchmark.t_ns, benchmark.rests_ns[0, 1])) if len(benchmark.rests_ns) else 0


def _fold_yaw(estimated: Estimate, benchmark: Reference) -> Folded:
    """Return the errors of yaw modulo 90 deg over the moving samples, with nothing aligned."""
    c = compare(estimated, benchmark, "none")
    yaw_deg = np.rad2deg(compute_euler_error(c.q_est[c.moving], c.q_true[c.moving], "nwu")[:, 2])
    folded_deg = np.mod(yaw_deg + 45.0, 90.0) - 45.0
    return Folded(float(np.sqrt(np.mean(folded_deg**2))), float(np.abs(folded_deg).max()))


def restart_integration(q_nb: Floats, other_q_nb: Floats, at: int) -> Floats:
    """Return an integration (N, 4) as if it had begun at sample ``at`` with the attitude of another.

    What was integrated until then is taken off in n, which is where an attitude that a gyro starts from comes in.
    """
    turn = rotation(other_q_nb[at]) * rotation(q_nb[at]).inv()
    return quaternion(turn * rotation(q_nb))


def time_long_run(minutes: float, hand: str, methods: Sequence[str] = _LONG_METHODS) -> list[LongRun]:
    """Run filters over one long recording of experiment 3; the time of each is that of the fastest of RUNS runs."""
    recording = simulate(EXPERIMENTS["phone-3"].hands[hand], seed=0, minutes=minutes)
    assert recording.truth is not None
    found = []
    for method in methods:
        name, params = ESTIMATORS[method]
        runs = [estimate(recording, name, params) for _ in range(RUNS)]
        scored = score(runs[0], recording.truth, "none")
        ns = min(run.ns_per_sample for run in runs)
        found.append(LongRun(method, name, scored.inclination_rmse_deg, scored.heading_rmse_deg, ns))
    return found


def compute_mean(trials: Sequence[Trial], method: str, judge: str, figure: str) -> float:
    """Return the mean over the trials of one figure of the scores."""
    return float(np.mean([getattr(one.scores[method, judge], figure) for one in trials]))


def compute_rms_drift_deg(trials: Sequence[Trial]) -> Floats:
    """Return the root mean square over the trials of the gyro's drift in roll, pitch, yaw (3,)."""
    return np.asarray(np.sqrt(np.mean(np.square([one.drift_deg for one in trials]), axis=0)), dtype=np.float64)


def _measure_tilt_at_start_deg(reference: Reference, truth: Truth) -> float:
    """Return the inclination error in deg of a reference at its first common sample with the truth."""
    c = compare(reference, truth, "none")
    return float(np.rad2deg(compute_attitude_error(c.q_est[:1], c.q_true[:1]).inclination_rad[0]))


def _make_series(
    truth: Truth | None, benchmark: Reference, references: Mapping[str, Reference], made: Mapping[str, Estimate]
) -> Series:
    """Return what the figures draw: angles in deg over s from before the first motion, and errors of the judges."""
    start = _find_first_motion(benchmark)
    zero_ns = int(benchmark.t_ns[start]) - round(LEAD_S * 1e9)
    turned: dict[str, Floats] = {name: reference.q_nb for name, reference in references.items()}
    for method, thing in made.items():
        assert thing.q_nb is not None
        if method != ACC_MA_CENTRED:  # has stamps of its own, and no figure of the paper
            turned[method] = restart_integration(thing.q_nb, benchmark.q_nb, start) if method == GYRO else thing.q_nb
    return Series(
        (benchmark.t_ns - zero_ns) / 1e9,
        {name: np.rad2deg(euler(q_nb, "nwu")) for name, q_nb in turned.items()},
        {} if truth is None else {name: _measure_error_over_time(r, truth, zero_ns) for name, r in references.items()},
        (benchmark.rests_ns - zero_ns) / 1e9,
    )


def _measure_error_over_time(reference: Reference, truth: Truth, zero_ns: int) -> tuple[Floats, Floats]:
    """Return times in s and the total error in deg of a reference against the truth."""
    c = compare(reference, truth, "none")
    error_deg = np.asarray(np.rad2deg(compute_attitude_error(c.q_est, c.q_true).total_rad), dtype=np.float64)
    return np.asarray((c.t_ns - zero_ns) / 1e9, dtype=np.float64), error_deg


EXPERIMENTS: dict[str, Scenario] = {
    "phone-1": Scenario(
        "phone-1",
        "A phone slid over a table",
        1,
        {"sliding": "phone-1"},
        {
            CF: (0.2417, 1.0120, 0.2649, 0.9774, 3.6089, 9.0839),
            ACC: (4.5700, 32.5064, 4.5130, 28.5369, 5.6379, 44.3094),
            ACC_MA: (0.9217, 2.3942, 0.3157, 0.9730, 9.4104, 44.9745),
        },
    ),
    "phone-2": Scenario(
        "phone-2",
        "A phone on a tripod",
        2,
        {"tripod": "phone-2"},
        {
            CF: (1.3490, 4.0197, 2.0848, 7.6263, 3.9181, 8.5216),
            ACC: (2.4396, 16.9520, 2.9234, 24.6859, 3.4014, 17.0069),
        },
    ),
    "phone-3": Scenario(
        "phone-3",
        "A phone in the hand",
        3,
        {"carried": "phone-3", "shaken": "phone-3-shaken", "level": "phone-3-level"},
        {
            CF: (1.2830, 9.4319, 1.8562, 8.0824, 4.3108, 11.9128),
            ACC: (26.5381, 16.9520, 16.1595, 69.6934, 16.3406, 44.9733),
        },
    ),
}
