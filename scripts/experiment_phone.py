"""``stillpoint experiment phone-1``, ``phone-2`` and ``phone-3``: the three experiments of paper 002."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.datasets.nearest import require_known
from stillpoint.scoring.phone_page import judge_rows, method_rows, phone_page
from stillpoint.scoring.phone_study import CF, EXPERIMENTS, HANDS, LongRun, Scenario, Trial, long_run, trial
from stillpoint.scoring.score import score_row
from stillpoint.scripts.flags import Jobs, OutDir, Whole
from stillpoint.scripts.inputs import output_dir
from stillpoint.scripts.jobs import run_jobs
from stillpoint.scripts.json_file import STDOUT, JsonFile, write_json
from stillpoint.scripts.tables import print_table
from stillpoint.scripts.text_file import write_text

COLUMNS = ("moved", "against", "method", "roll, deg", "pitch, deg", "yaw, deg", "tilt", "heading")
AGAINST_KALMAN = {CF: "cf", "Kalman, per axis": "kf-axis", "Kalman, error state": "ekf"}


@dataclass(frozen=True)
class _Job:
    scenario: Scenario
    hand: str
    seed: int


def sliding(
    *, trials: Whole = 5, seed: Whole = 0, out: OutDir = Path(), jobs: Jobs = None, json: JsonFile = None
) -> None:
    """Experiment 1 of paper 002: a phone slid over a table, turned about the vertical only.

    Writes phone-1.experiment.html: the paper's table 2 and figures 5 to 8 beside ours, against the paper's benchmark,
    the graph and the truth, and the error of the benchmark itself.

    Parameters
    ----------
    trials
        How many recordings, with rising seeds.
    seed
        Seed of the first recording.
    out
        Folder to write into; made when it is not there.
    jobs
        Processes; by default one per core.
    json
        Also write every figure as JSON to this file; - is the standard output.
    """
    _run(EXPERIMENTS["phone-1"], tuple(EXPERIMENTS["phone-1"].hands), trials, seed, 0.0, out, jobs, json)


def tripod(
    *, trials: Whole = 5, seed: Whole = 0, out: OutDir = Path(), jobs: Jobs = None, json: JsonFile = None
) -> None:
    """Experiment 2 of paper 002: a phone on a tripod, turned slowly about all axes; and the drift of its gyro.

    Writes phone-2.experiment.html: the paper's table 3 and figures 10 to 12 beside ours, against the paper's benchmark,
    the graph and the truth, and the error of the benchmark itself.

    Parameters
    ----------
    trials
        How many recordings, with rising seeds.
    seed
        Seed of the first recording.
    out
        Folder to write into; made when it is not there.
    jobs
        Processes; by default one per core.
    json
        Also write every figure as JSON to this file; - is the standard output.
    """
    _run(EXPERIMENTS["phone-2"], tuple(EXPERIMENTS["phone-2"].hands), trials, seed, 0.0, out, jobs, json)


def in_hand(
    *,
    hand: str | None = None,
    trials: Whole = 5,
    seed: Whole = 0,
    minutes: float = 10.0,
    out: OutDir = Path(),
    jobs: Jobs = None,
    json: JsonFile = None,
) -> None:
    """Experiment 3 of paper 002: a phone in the hand, violent turns and accelerations; and CF against Kalman filters.

    Writes phone-3.experiment.html: the paper's table 4 and figures 13 to 15 beside ours, against the paper's benchmark,
    the graph and the truth, the error of the benchmark itself, and accuracy and time of the Kalman filters.

    Parameters
    ----------
    hand
        carried (about, and jolted), or shaken (evenly in one place); by default both.
    trials
        How many recordings per hand, with rising seeds.
    seed
        Seed of the first recording.
    minutes
        Length of the recording of the comparison with Kalman filters; the paper's has 120.
    out
        Folder to write into; made when it is not there.
    jobs
        Processes; by default one per core.
    json
        Also write every figure as JSON to this file; - is the standard output.
    """
    if hand is not None:
        require_known(hand, HANDS, "hand")
    _run(EXPERIMENTS["phone-3"], (hand,) if hand else tuple(HANDS), trials, seed, minutes, out, jobs, json)


def _run(
    scenario: Scenario,
    hands: Sequence[str],
    trials: int,
    seed: int,
    minutes: float,
    out: Path,
    jobs: int | None,
    json: str | None,
) -> None:
    if trials < 1 or seed < 0:
        raise BadParameter(f"--trials {trials} --seed {seed}: give 1 trial or more, and a seed from 0 on")
    long_runs = long_run(minutes, hands[0], AGAINST_KALMAN) if minutes else []
    folder = output_dir(out)
    work = [_Job(scenario, hand, seed + k) for hand in hands for k in range(trials)]
    outcomes = run_jobs(_trial, work, jobs, "trials")
    failed = next((outcome.error for outcome in outcomes if outcome.value is None), None)
    if failed is not None:
        raise StillpointError(failed)
    made = [outcome.value for outcome in outcomes if outcome.value is not None]
    by_hand = {hand: [one for one in made if one.hand == hand] for hand in hands}
    page = folder / f"{scenario.name}.experiment.html"
    command = _command(scenario, hands, trials, seed, minutes)
    write_text(page, phone_page(scenario, by_hand, long_runs, minutes, command))
    if json != STDOUT:
        _print(scenario, by_hand, trials, long_runs, minutes)
        print(page)
    rows = [row for one in made for row in _facts(one)]
    write_json(json, rows + [{"minutes": minutes, **asdict(run)} for run in long_runs])


def _trial(job: _Job) -> Trial:
    return trial(job.scenario, job.hand, job.seed)


def _print(
    scenario: Scenario,
    by_hand: Mapping[str, Sequence[Trial]],
    trials: int,
    long_runs: Sequence[LongRun],
    minutes: float,
) -> None:
    rows = [*method_rows(scenario, by_hand), *judge_rows(by_hand)]
    sections: list[list[list[str]]] = []
    for row in rows:
        if row["first"]:
            sections.append([])
        sections[-1].append(_cells(row))
    print_table(f"{scenario.name}: mean of {trials} trials, RMSE / largest error", COLUMNS, sections, texts=3)
    for run in long_runs:
        print(
            f"{minutes:g} min {run.method} ({run.estimator}): tilt {run.tilt_rmse_deg:.2f}, heading "
            f"{run.heading_rmse_deg:.2f} deg, {run.ns_per_sample:.0f} ns per sample, "
            f"{run.ns_per_sample / long_runs[0].ns_per_sample:.1f} times {long_runs[0].method}'s"
        )


def _cells(row: Mapping[str, Any]) -> list[str]:
    pairs = zip(row["euler"][::2], row["euler"][1::2], strict=True)
    beside = ["-" if value is None else f"{value:.2f}" for value in row["beside"]]
    return [row["hand"], row["judge"], row["method"], *(f"{rmse:.2f} / {most:.1f}" for rmse, most in pairs), *beside]


def _facts(one: Trial) -> list[dict[str, Any]]:
    place = {"hand": one.hand, "seed": one.seed}
    scored = [
        {**score_row(score), **place, "method": method, "against": judge}
        for (method, judge), score in one.scores.items()
    ]
    drift = dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), one.drift_deg, strict=True))
    return [*scored, {**place, "method": "Gyro", "drift_in_a_minute": drift}]


def _command(scenario: Scenario, hands: Sequence[str], trials: int, seed: int, minutes: float) -> str:
    words = [f"stillpoint experiment {scenario.name}"]
    words += [f"--hand {hands[0]}"] if len(hands) < len(scenario.hands) else []
    words += [f"--trials {trials} --seed {seed}", *([f"--minutes {minutes:g}"] if minutes else [])]
    return " ".join(words)
