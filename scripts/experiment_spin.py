"""``stillpoint experiment spin-constant`` and ``spin-variable``: the two scenarios of paper 000."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.scoring.roll import roll_score_row
from stillpoint.scoring.roll_page import roll_page
from stillpoint.scoring.roll_study import (
    CONSTANT,
    METRICS,
    NOISES,
    VARIABLE,
    NoiseKind,
    Reading,
    Scenario,
    Trial,
    trial,
    worst,
)
from stillpoint.scripts.flags import Jobs, OutDir, Whole
from stillpoint.scripts.inputs import output_dir
from stillpoint.scripts.jobs import run_jobs
from stillpoint.scripts.json_file import STDOUT, JsonFile, write_json
from stillpoint.scripts.tables import print_table
from stillpoint.scripts.text_file import write_text

COLUMNS = ("noise", "method", "angle max, deg", "angle RMSE", "rate max, deg/s", "rate RMSE")
TRIALS = {False: 10, True: 5}  # offline, online

Online = Annotated[bool, Parameter(negative=())]


@dataclass(frozen=True)
class _Job:
    scenario: Scenario
    noise: NoiseKind
    seed: int
    online: bool
    reading: Reading | None


def constant(
    *,
    online: Online = False,
    noise: NoiseKind | None = None,
    reading: Reading | None = None,
    trials: Whole | None = None,
    seed: Whole = 0,
    out: OutDir = Path(),
    jobs: Jobs = None,
    json: JsonFile = None,
) -> None:
    """Roll angle and rate at 2020 deg/s over 30 s: observation, EKF, AEKF, the guarded filter and the smoother.

    Writes spin-constant.experiment.html (online: spin-constant-online.experiment.html): bars per trial and rates over
    time as the paper draws them, the worst of the trials and who wins how often beside the paper's printed numbers.

    Parameters
    ----------
    online
        As on a microcontroller: five trials, in single precision, without the smoother.
    noise
        What the noise is made of: white, vibration (of the motor, on F5), glitch (of the slip rings, on F4) or replica
        (nearest to the paper's numbers); by default all four, one after the other.
    reading
        The paper's equations as printed, or by default as this project reads them; replica takes them as printed.
    trials
        How many, with rising seeds; by default ten, online five.
    seed
        Seed of the first trial.
    out
        Folder to write into; made when it is not there.
    jobs
        Processes; by default one per core.
    json
        Also write every figure as JSON to this file; - is the standard output.
    """
    _run(CONSTANT, online, noise, reading, trials, seed, out, jobs, json)


def variable(
    *,
    online: Online = False,
    noise: NoiseKind | None = None,
    reading: Reading | None = None,
    trials: Whole | None = None,
    seed: Whole = 0,
    out: OutDir = Path(),
    jobs: Jobs = None,
    json: JsonFile = None,
) -> None:
    """Roll angle and rate at 1500-2100 deg/s over 60 s: observation, EKF, AEKF, the guarded filter and the smoother.

    Writes spin-variable.experiment.html (online: spin-variable-online.experiment.html): bars per trial and rates over
    time as the paper draws them, the worst of the trials and who wins how often beside the paper's printed numbers.

    Parameters
    ----------
    online
        As on a microcontroller: five trials, in single precision, without the smoother.
    noise
        What the noise is made of: white, vibration (of the motor, on F5), glitch (of the slip rings, on F4) or replica
        (nearest to the paper's numbers); by default all four, one after the other.
    reading
        The paper's equations as printed, or by default as this project reads them; replica takes them as printed.
    trials
        How many, with rising seeds; by default ten, online five.
    seed
        Seed of the first trial.
    out
        Folder to write into; made when it is not there.
    jobs
        Processes; by default one per core.
    json
        Also write every figure as JSON to this file; - is the standard output.
    """
    _run(VARIABLE, online, noise, reading, trials, seed, out, jobs, json)


def _run(
    scenario: Scenario,
    online: bool,
    noise: NoiseKind | None,
    reading: Reading | None,
    trials: int | None,
    seed: int,
    out: Path,
    jobs: int | None,
    json: str | None,
) -> None:
    count = TRIALS[online] if trials is None else trials
    if count < 1 or seed < 0:
        raise BadParameter(f"--trials {count} --seed {seed}: give 1 trial or more, and a seed from 0 on")
    noises = NOISES if noise is None else (noise,)
    work = [_Job(scenario, kind, seed + k, online, reading) for kind in noises for k in range(count)]
    folder = output_dir(out)
    outcomes = run_jobs(_trial, work, jobs, "trials")
    failed = next((outcome.error for outcome in outcomes if outcome.value is None), None)
    if failed is not None:
        raise StillpointError(failed)
    made = [outcome.value for outcome in outcomes if outcome.value is not None]
    by_noise = {kind: [one for one in made if one.noise == kind] for kind in noises}
    name = f"{scenario.name}{'-online' if online else ''}"
    page = folder / f"{name}.experiment.html"
    write_text(page, roll_page(scenario, by_noise, online, _command(scenario, online, noise, reading, count, seed)))
    if json != STDOUT:
        print_table(f"{name}: the worst of {count} trials", COLUMNS, [_rows(some) for some in by_noise.values()])
        print(page)
    write_json(json, [row for one in made for row in _facts(one)])


def _trial(job: _Job) -> Trial:
    return trial(job.scenario, job.noise, job.seed, job.online, job.reading)


def _rows(trials: Sequence[Trial]) -> list[list[str]]:
    rows = []
    for method in trials[0].scores:
        figures = (worst(trials, method, metric) for metric in METRICS)
        rows.append([trials[0].noise, method, *("-" if value is None else f"{value:.2f}" for value in figures)])
    return rows


def _facts(one: Trial) -> list[dict[str, Any]]:
    place = {"noise": one.noise, "seed": one.seed}
    scored = [{**place, **roll_score_row(score), "method": method} for method, score in one.scores.items()]
    return scored + [{**place, "method": method, "error": error} for method, error in one.refused.items()]


def _command(
    scenario: Scenario, online: bool, noise: NoiseKind | None, reading: Reading | None, trials: int, seed: int
) -> str:
    words = ["stillpoint experiment", scenario.name, *(["--online"] if online else [])]
    words += [f"--noise {noise}"] if noise else []
    words += [f"--reading {reading}"] if reading else []
    return " ".join([*words, f"--trials {trials} --seed {seed}"])
