"""The two experiments of Asghari et al. 2018 on simulated trials: methods, printed figures, and who wins how often.

As :mod:`stillpoint.studies.validation`, a study that runs filters and smoother. The paper's recordings are not public;
trials come from :mod:`stillpoint.datasets.simulate`, under five hypotheses of what the sensors' noise was made of.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any, Literal, get_args

import numpy as np

from stillpoint.datasets.errors import StillpointError
from stillpoint.datasets.recording import Encoder, Recording
from stillpoint.datasets.settings import choose_settings
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.trajectory import Estimate, SpinReference
from stillpoint.filters import SpinStream, estimate
from stillpoint.filters.table import find_estimator
from stillpoint.scoring.report.spin_figures import RateSeries
from stillpoint.scoring.spin import SpinScore, compare_spin, score_spin_comparison
from stillpoint.smoother import reference

NoiseKind = Literal["white", "vibration", "vibration-f4", "glitch", "replica"]
NOISES: tuple[NoiseKind, ...] = get_args(NoiseKind)
Reading = Literal["default", "printed"]
LITERAL = ("vibration-f4", "replica")  # hypotheses that belong with the paper's equations as printed
EQUAL = 1e-6  # figures this close, relatively, are a tie: with Q as printed the AEKF is the EKF
METRICS = ("angle_max_deg", "angle_rmse_deg", "rate_max_degps", "rate_rmse_degps")
OF_PAPER = ("observation", "EKF", "AEKF")
SMOOTHER = "smoother"
# 3 deg after 30 s, as printed, take F4 to 1 mg and d1 to 0.01 %: the paper's rig was calibrated.
_CALIBRATED = {"calibration.accel_bias_sd_mps2": 0.01, "calibration.lever_arm_sd": 1e-4}  # what the smoother assumes
FILTERS = {"observation": "roll-obs", "EKF": "roll-ekf", "AEKF": "roll-aekf", "guarded": "roll-guarded"}


@dataclass(frozen=True)
class Printed:
    """Figures that the paper prints of a scenario: the worst trial, and how many trials each method wins."""

    worst: Mapping[tuple[str, str], float]  # (method, metric)
    wins: Mapping[str, Mapping[str, int]]  # metric -> method -> trials
    figures: Mapping[str, str]  # metric -> number of the figure


@dataclass(frozen=True)
class Scenario:
    """One of the two experiments."""

    name: str  # of the simulation, too
    title: str
    seconds: float
    settings: Mapping[str, Any]  # of all filters: R and Q of the paper as variances of its accelerometers
    adaptive: Mapping[str, Any]  # of the AEKF besides
    printed: Mapping[bool, Printed]  # offline (False) and online (True)


@dataclass(frozen=True)
class Trial:
    """One recording: a score per method, or the reason why there is none."""

    noise: str  # a NoiseKind, or the judge of a recording
    seed: int  # of a recording, its place among the given ones
    scores: Mapping[str, SpinScore]
    refused: Mapping[str, str] = field(default_factory=dict)
    params: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    series: RateSeries | None = None


def run_trial(
    scenario: Scenario, noise: NoiseKind, seed: int, online: bool = False, reading: Reading | None = None
) -> Trial:
    """Simulate and score one trial; online means sample by sample in single precision, without the smoother.

    ``reading`` of the paper's equations: None takes them as printed for the noises LITERAL and ours elsewhere.
    """
    recording = simulate(scenario.name, seed=seed, sensor=noise)
    printed = reading == "printed" or (reading is None and noise in LITERAL)
    return score_trial(recording, scenario, noise, seed, online, printed)


def score_trial(
    recording: Recording, scenario: Scenario, noise: NoiseKind, seed: int, online: bool = False, printed: bool = False
) -> Trial:
    """Run the methods over one recording with its truth and score them; ``printed`` is the reading of the equations."""
    made: dict[str, Estimate | SpinReference] = {}
    refused: dict[str, str] = {}
    for method in (*FILTERS, *(() if online else (SMOOTHER,))):
        try:
            made[method] = _run_method(recording, method, scenario, printed, online)
        except StillpointError as error:
            refused[method] = str(error)
    assert recording.roll_truth is not None
    compared = {method: compare_spin(thing, recording.roll_truth) for method, thing in made.items()}
    return Trial(
        noise,
        seed,
        {method: score_spin_comparison(c) for method, c in compared.items()},
        refused,
        {method: dict(thing.params) for method, thing in made.items()},
        make_series(recording, made, recording.roll_truth),
    )


def make_settings(scenario: Scenario, method: str, printed: bool) -> dict[str, Any]:
    """Return the parameters of one filter, in our reading or as the paper prints its equations.

    All but lambda: in (19) and again in (20), as printed, it makes the variance negative, and there would be no score.
    """
    settings = dict(scenario.settings)
    if method in OF_PAPER:
        settings["saturated"] = "use"
    if method in ("EKF", "AEKF") and printed:
        settings |= {"process_noise": "literal", "first_rate": "first"}
    if method == "AEKF":
        settings |= dict(scenario.adaptive) | ({"mean": "literal"} if printed else {})
    return settings


def find_worst(trials: Sequence[Trial], method: str, metric: str) -> float | None:
    """Return the largest figure of a method over its trials; None where it has none."""
    found = [getattr(one.scores[method], metric) for one in trials if method in one.scores]
    return max(found) if found else None


def count_wins(trials: Sequence[Trial], metric: str, methods: Sequence[str]) -> dict[str, int]:
    """Count in how many trials each of the methods has the smallest figure; a tie counts for all who share it."""
    counted = dict.fromkeys(methods, 0)
    for one in trials:
        figures = {method: getattr(one.scores[method], metric) for method in methods if method in one.scores}
        for method, figure in figures.items():
            counted[method] += figure <= min(figures.values()) * (1 + EQUAL)
    return counted


def count_in_order(trials: Sequence[Trial], metric: str, methods: Sequence[str]) -> int:
    """Count in how many trials the figure falls from each of the methods to the next."""
    figures = [[getattr(one.scores[m], metric) for m in methods] for one in trials if set(methods) <= set(one.scores)]
    return sum(all(a > b for a, b in pairwise(row)) for row in figures)


def _run_method(
    recording: Recording, method: str, scenario: Scenario, printed: bool, online: bool
) -> Estimate | SpinReference:
    """Run a filter or the smoother over a recording with the settings of a scenario."""
    if method == SMOOTHER:
        found = reference(recording, params=_CALIBRATED)
        assert isinstance(found, SpinReference)
        return found
    settings = make_settings(scenario, method, printed)
    if online:
        return stream_estimate(recording, FILTERS[method], settings)
    return estimate(recording, FILTERS[method], settings)


def stream_estimate(recording: Recording, name: str, settings: Mapping[str, Any]) -> Estimate:
    """Return what an estimator of a spin says when it is fed sample by sample in single precision, as on a device."""
    assert recording.spin is not None
    spin = recording.spin
    params = choose_settings(find_estimator(name).params(), settings, name)
    stream = SpinStream(name, spin.geometry, params, "single")
    rows = zip(spin.t_ns.tolist(), spin.accel_mps2.tolist(), spin.gyro_radps.tolist(), strict=True)
    answers = [stream.update(*row) for row in rows]
    angle, rate, angle_sd, rate_sd, _, ready = (np.array(column) for column in zip(*answers, strict=True))
    return Estimate(
        t_ns=spin.t_ns,
        name=name,
        recording=recording.name,
        angle_rad=angle.astype(np.float64),
        rate_radps=rate.astype(np.float64),
        angle_sd_rad=angle_sd.astype(np.float64),
        rate_sd_radps=rate_sd.astype(np.float64),
        ready=ready.astype(np.bool_),
        params=asdict(params),
        diagnostics={"precision": "single", "fed": "sample by sample"} | stream.counts,
    )


def make_series(
    recording: Recording, made: Mapping[str, Estimate | SpinReference], truth: Encoder | SpinReference
) -> RateSeries | None:
    """Return the rates over time, with that of the truth; None for an encoder that gives no rate."""
    assert recording.spin is not None
    t_ns = recording.spin.t_ns
    if truth.rate_radps is None:
        return None
    rates = {method: np.asarray(thing.rate_radps) for method, thing in made.items()}
    t_s = (t_ns - t_ns[0]) / 1e9
    return RateSeries(t_s, np.interp(t_ns, truth.t_ns, truth.rate_radps), rates)


CONSTANT = Scenario(
    name="spin-constant",
    title="Roll at constant speed",
    seconds=30.0,
    settings={"radial_var_m2ps4": 0.8, "tangential_var_m2ps4": 0.125},  # R = 80, Q = 0.5
    adaptive={"window": 5, "mode": "observation"},
    printed={
        False: Printed(
            worst={
                ("AEKF", "angle_max_deg"): 3.0,
                ("observation", "angle_rmse_deg"): 1.42,
                ("AEKF", "rate_max_degps"): 20.92,
                ("AEKF", "rate_rmse_degps"): 1.25,
            },
            wins={
                "angle_max_deg": {"EKF": 2, "AEKF": 7},
                "angle_rmse_deg": {"EKF": 1, "AEKF": 8},
                "rate_max_degps": {"AEKF": 10},
                "rate_rmse_degps": {"AEKF": 10},
            },
            figures=dict(zip(METRICS, ("10", "11", "12", "13"), strict=True)),
        ),
        True: Printed(
            worst={("AEKF", "angle_max_deg"): 3.25, ("observation", "angle_rmse_deg"): 1.65},
            wins={
                "angle_max_deg": {"observation": 2, "AEKF": 3},
                "angle_rmse_deg": {"observation": 2, "AEKF": 3},
                "rate_max_degps": {"EKF": 4, "AEKF": 1},
                "rate_rmse_degps": {"AEKF": 5},
            },
            figures=dict(zip(METRICS, ("14", "15", "16", "17"), strict=True)),
        ),
    },
)
VARIABLE = Scenario(
    name="spin-variable",
    title="Roll at variable speed",
    seconds=60.0,
    settings={"radial_var_m2ps4": 0.4, "tangential_var_m2ps4": 3.0},  # R = 40, Q = 12
    adaptive={"window": 10, "mode": "system"},
    printed={
        False: Printed(
            worst={
                ("AEKF", "angle_max_deg"): 3.74,
                ("EKF", "angle_max_deg"): 4.39,
                ("observation", "angle_max_deg"): 3.88,
                ("AEKF", "angle_rmse_deg"): 1.93,
                ("EKF", "angle_rmse_deg"): 2.31,
                ("observation", "angle_rmse_deg"): 2.85,
            },
            wins={
                "angle_max_deg": {"EKF": 1, "AEKF": 7},
                "angle_rmse_deg": {"EKF": 1, "AEKF": 6},
                "rate_max_degps": {"EKF": 7, "AEKF": 3},
                "rate_rmse_degps": {"AEKF": 10},
            },
            figures=dict(zip(METRICS, ("19", "20", "21", "22"), strict=True)),
        ),
        True: Printed(
            worst={
                ("AEKF", "angle_max_deg"): 2.65,
                ("EKF", "angle_max_deg"): 4.76,
                ("observation", "angle_max_deg"): 3.15,
                ("AEKF", "angle_rmse_deg"): 1.86,
                ("EKF", "angle_rmse_deg"): 2.40,
                ("observation", "angle_rmse_deg"): 2.22,
            },
            wins={
                "angle_max_deg": {"EKF": 3, "AEKF": 2},
                "angle_rmse_deg": {"EKF": 2, "AEKF": 3},
                "rate_max_degps": {"EKF": 2, "AEKF": 3},
                "rate_rmse_degps": {"EKF": 1, "AEKF": 4},
            },
            figures=dict(zip(METRICS, ("23", "24", "25", "26"), strict=True)),
        ),
    },
)
