"""``stillpoint experiment spin-constant`` and ``spin-variable``: the experiments of Asghari et al. 2018."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.scoring.spin import spin_score_row
from stillpoint.scripts.shared.inputs import make_output_dir
from stillpoint.scripts.shared.output import STDOUT, print_line, write_json, write_text
from stillpoint.scripts.shared.recordings import open_recording
from stillpoint.scripts.shared.tables import print_table
from stillpoint.scripts.verbs.experiments.trials import FIRST_ONLINE, Trials
from stillpoint.studies.papers.spin.page import make_spin_page
from stillpoint.studies.papers.spin.recorded import RECORDED, identify_noise, score_recording
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

_COLUMNS = ("noise", "method", "angle max, deg", "angle RMSE", "rate max, deg/s", "rate RMSE")
_PAPER = {False: 10, True: 5}  # trials, offline and online


@Parameter(name="*")
@dataclass(frozen=True)
class SpinTrials(Trials):
    """The options of both scenarios.

    Parameters
    ----------
    online
        As on a microcontroller: fed sample by sample in single precision, without the smoother; simulated trials have
        seeds of their own, from 10 on.
    noise
        What the noise is made of: white, vibration (of the motor, on F5), vibration-f4, glitch (of the slip rings, on
        F4) or replica (nearest to the paper's numbers); by default all five, one after the other.
    reading
        The paper's equations as printed, or by default as this project reads them; vibration-f4 and replica take them
        as printed. One stays as it is read: lambda of (23) once. In (19) and again in (20), as printed, the variance
        turns negative.
    """

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
    """A simulated trial to score."""

    scenario: Scenario
    noise: NoiseKind
    seed: int
    online: bool
    reading: Reading | None


@dataclass(frozen=True)
class _File:
    """A recording to score, numbered among those given."""

    scenario: Scenario
    file: Path
    number: int
    noise: Mapping[str, float]
    online: bool
    reading: Reading | None


def constant(*, trials: SpinTrials = SpinTrials()) -> None:
    """Roll angle and rate at 2020 deg/s over 30 s: observation, EKF, AEKF, the guarded filter and the smoother.

    Writes spin-constant.experiment.html (online: spin-constant-online.experiment.html): bars per trial and rates over
    time as the paper draws them, the worst of the trials and who wins how often beside the paper's printed numbers.
    """
    _run_experiment(CONSTANT, trials)


def variable(*, trials: SpinTrials = SpinTrials()) -> None:
    """Roll angle and rate at 1500-2100 deg/s over 60 s: observation, EKF, AEKF, the guarded filter and the smoother.

    Writes spin-variable.experiment.html (online: spin-variable-online.experiment.html): bars per trial and rates over
    time as the paper draws them, the worst of the trials and who wins how often beside the paper's printed numbers.
    """
    _run_experiment(VARIABLE, trials)


def _run_experiment(scenario: Scenario, wanted: SpinTrials) -> None:
    """Run an experiment under the noises or over the files that are asked for, write its page and print its table."""
    files = wanted.files
    wanted.refuse(noise=wanted.noise)
    trials = wanted if files else _fill_defaults(wanted)
    folder = make_output_dir(trials.out)
    if files:
        by_noise: dict[str, list[Trial]] = _score_files(scenario, trials, files)
    else:
        noises = NOISES if trials.noise is None else (trials.noise,)
        work = [_Job(scenario, kind, seed, trials.online, trials.reading) for kind in noises for seed in trials.seeds]
        made = trials.run(_run_trial, work, "trials")
        by_noise = {kind: [one for one in made if one.noise == kind] for kind in noises}
    name = f"{scenario.name}{'-online' if trials.online else ''}"
    page = folder / f"{name}.experiment.html"
    command = f"stillpoint experiment {scenario.name} {trials.words}"
    write_text(page, make_spin_page(scenario, by_noise, trials.online, command))
    if trials.json != STDOUT:
        count = len(next(iter(by_noise.values())))
        title = f"{name}: the worst of {count} {'recordings' if files else 'trials'}"
        print_table(title, _COLUMNS, [_make_rows(some) for some in by_noise.values()])
        print_line(page)
    write_json(trials.json, [row for some in by_noise.values() for one in some for row in _list_facts(one)])


def _fill_defaults(wanted: SpinTrials) -> SpinTrials:
    """Return the options with the paper's number of trials, and with fresh seeds where they run online."""
    count = _PAPER[wanted.online] if wanted.trials is None else wanted.trials
    first = (FIRST_ONLINE if wanted.online else 0) if wanted.seed is None else wanted.seed
    return replace(wanted, trials=count, seed=first)


def _score_files(scenario: Scenario, trials: SpinTrials, files: Sequence[Path]) -> dict[str, list[Trial]]:
    """Identify the noise over all recordings, then run the methods over each; trials by judge."""
    noise = identify_noise([open_recording(file) for file in files])
    work = [_File(scenario, file, k, noise, trials.online, trials.reading) for k, file in enumerate(files)]
    made = [one for some in trials.run(_score_file, work, "recordings") for one in some]
    return {judge: some for judge in RECORDED if (some := [one for one in made if one.noise == judge])}


def _score_file(job: _File) -> list[Trial]:
    recording = open_recording(job.file)
    return score_recording(recording, job.number, job.scenario, job.noise, job.online, job.reading == "printed")


def _run_trial(job: _Job) -> Trial:
    return run_trial(job.scenario, job.noise, job.seed, job.online, job.reading)


def _make_rows(trials: Sequence[Trial]) -> list[list[str]]:
    """Return the rows of the table: the worst figures of each method."""
    rows = []
    for method in trials[0].scores:
        figures = (find_worst(trials, method, metric) for metric in METRICS)
        rows.append([trials[0].noise, method, *("-" if value is None else f"{value:.2f}" for value in figures)])
    return rows


def _list_facts(one: Trial) -> list[dict[str, Any]]:
    """Return the scores of a trial for ``--json``, and why methods were refused."""
    place = {"noise": one.noise, "seed": one.seed}
    scored = [{**place, **spin_score_row(score), "method": method} for method, score in one.scores.items()]
    return scored + [{**place, "method": method, "error": error} for method, error in one.refused.items()]
