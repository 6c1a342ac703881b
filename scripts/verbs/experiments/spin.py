"""``stillpoint experiment spin-constant`` and ``spin-variable``: the experiments of Asghari et al. 2018."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.scoring.spin import spin_score_row
from stillpoint.scripts.shared.flags import Whole
from stillpoint.scripts.shared.inputs import output_dir
from stillpoint.scripts.shared.output import STDOUT, print_line, write_json, write_text
from stillpoint.scripts.shared.tables import print_table
from stillpoint.scripts.verbs.experiments.trials import Trials
from stillpoint.studies.papers.spin.page import spin_page
from stillpoint.studies.papers.spin.study import (
    CONSTANT,
    METRICS,
    NOISES,
    VARIABLE,
    NoiseKind,
    Reading,
    Scenario,
    Trial,
    find_worst,
    run_trial,
)

COLUMNS = ("noise", "method", "angle max, deg", "angle RMSE", "rate max, deg/s", "rate RMSE")
PAPER = {False: 10, True: 5}  # trials, offline and online


@Parameter(name="*")
@dataclass(frozen=True)
class SpinTrials(Trials):
    """The options of both scenarios.

    Parameters
    ----------
    trials
        How many of each kind, with rising seeds; by default as many as the paper has, ten, or five online.
    online
        As on a microcontroller: in single precision, without the smoother.
    noise
        What the noise is made of: white, vibration (of the motor, on F5), glitch (of the slip rings, on F4) or replica
        (nearest to the paper's numbers); by default all four, one after the other.
    reading
        The paper's equations as printed, or by default as this project reads them; replica takes them as printed. One
        stays as it is read: lambda of (23) once. In (19) and again in (20), as printed, the variance turns negative.
    """

    trials: Whole | None = None  # type: ignore[assignment]  # a number before any trial is made
    online: Annotated[bool, Parameter(negative=())] = False
    noise: NoiseKind | None = None
    reading: Reading | None = None

    @property
    def words(self) -> str:
        """Return the options as words of a command that gives the same trials."""
        words = [*(["--online"] if self.online else []), *([f"--noise {self.noise}"] if self.noise else [])]
        return " ".join([*words, *([f"--reading {self.reading}"] if self.reading else []), super().words])


@dataclass(frozen=True)
class _Job:
    scenario: Scenario
    noise: NoiseKind
    seed: int
    online: bool
    reading: Reading | None


def constant(*, trials: SpinTrials = SpinTrials()) -> None:
    """Roll angle and rate at 2020 deg/s over 30 s: observation, EKF, AEKF, the guarded filter and the smoother.

    Writes spin-constant.experiment.html (online: spin-constant-online.experiment.html): bars per trial and rates over
    time as the paper draws them, the worst of the trials and who wins how often beside the paper's printed numbers.
    """
    _run(CONSTANT, trials)


def variable(*, trials: SpinTrials = SpinTrials()) -> None:
    """Roll angle and rate at 1500-2100 deg/s over 60 s: observation, EKF, AEKF, the guarded filter and the smoother.

    Writes spin-variable.experiment.html (online: spin-variable-online.experiment.html): bars per trial and rates over
    time as the paper draws them, the worst of the trials and who wins how often beside the paper's printed numbers.
    """
    _run(VARIABLE, trials)


def _run(scenario: Scenario, wanted: SpinTrials) -> None:
    trials = replace(wanted, trials=PAPER[wanted.online] if wanted.trials is None else wanted.trials)
    noises = NOISES if trials.noise is None else (trials.noise,)
    work = [_Job(scenario, kind, seed, trials.online, trials.reading) for kind in noises for seed in trials.seeds]
    folder = output_dir(trials.out)
    made = trials.run(_run_trial, work, "trials")
    by_noise = {kind: [one for one in made if one.noise == kind] for kind in noises}
    name = f"{scenario.name}{'-online' if trials.online else ''}"
    page = folder / f"{name}.experiment.html"
    command = f"stillpoint experiment {scenario.name} {trials.words}"
    write_text(page, spin_page(scenario, by_noise, trials.online, command))
    if trials.json != STDOUT:
        columns = [_make_rows(some) for some in by_noise.values()]
        print_table(f"{name}: the worst of {trials.trials} trials", COLUMNS, columns)
        print_line(page)
    write_json(trials.json, [row for one in made for row in _list_facts(one)])


def _run_trial(job: _Job) -> Trial:
    return run_trial(job.scenario, job.noise, job.seed, job.online, job.reading)


def _make_rows(trials: Sequence[Trial]) -> list[list[str]]:
    rows = []
    for method in trials[0].scores:
        figures = (find_worst(trials, method, metric) for metric in METRICS)
        rows.append([trials[0].noise, method, *("-" if value is None else f"{value:.2f}" for value in figures)])
    return rows


def _list_facts(one: Trial) -> list[dict[str, Any]]:
    place = {"noise": one.noise, "seed": one.seed}
    scored = [{**place, **spin_score_row(score), "method": method} for method, score in one.scores.items()]
    return scored + [{**place, "method": method, "error": error} for method, error in one.refused.items()]
