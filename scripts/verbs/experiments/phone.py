"""``stillpoint experiment phone-1``, ``phone-2`` and ``phone-3``: the three of Elmi Aziz and
Mohseni Araste 2021."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cyclopts import Parameter

from stillpoint.datasets.calibration.apply import apply_calibration
from stillpoint.datasets.errors import BadParameter, require_known
from stillpoint.datasets.mcap.store import sha256
from stillpoint.scoring.score import score_row
from stillpoint.scripts.shared.inputs import make_output_dir
from stillpoint.scripts.shared.output import STDOUT, print_line, write_json, write_text
from stillpoint.scripts.shared.recordings import find_calibration, open_recording
from stillpoint.scripts.shared.tables import print_table
from stillpoint.scripts.verbs.experiments.trials import SIMULATED, Trials
from stillpoint.studies.papers.phone.page import make_judge_rows, make_method_rows, make_phone_page
from stillpoint.studies.papers.phone.study import (
    EXPERIMENTS,
    PRINTED_KALMAN_GAIN,
    RECORDED,
    LongRun,
    Scenario,
    Trial,
    run_trial,
    score_trial,
    time_long_run,
)

_COLUMNS = ("moved", "against", "method", "roll, deg", "pitch, deg", "yaw, deg", "tilt", "heading")
_MINUTES = 10.0  # of the comparison with Kalman filters, by default


@Parameter(name="*")
@dataclass(frozen=True)
class Correction:
    """How your own recordings are corrected before the methods see them.

    Parameters
    ----------
    calibration
        Of --recording. none, the default: the methods see the samples as recorded. reference: first corrected by what
        the graph found about the sensor, as by estimate. Or a file with a calibration.
    """

    calibration: str | None = None


AS_RECORDED = Correction()


@dataclass(frozen=True)
class _Job:
    """A simulated trial to score."""

    scenario: Scenario
    hand: str
    seed: int


@dataclass(frozen=True)
class _File:
    """A recording to score, with the calibration that was asked for."""

    path: Path
    calibration: str  # none, reference or a file


def sliding(*, correction: Correction = AS_RECORDED, trials: Trials = SIMULATED) -> None:
    """Repeat experiment 1 of Elmi Aziz and Mohseni Araste 2021: a phone slid over a table.

    Writes phone-1.experiment.html: the paper's table 2 and figures 5 to 8 beside ours, against the paper's benchmark,
    the graph and the truth, the error of the benchmark itself, and the errors of CF over its two parameters.
    """
    _run_experiment("phone-1", None, trials, correction)


def tripod(*, correction: Correction = AS_RECORDED, trials: Trials = SIMULATED) -> None:
    """Repeat experiment 2 of Elmi Aziz and Mohseni Araste 2021: a phone on a tripod, and its gyro.

    Writes phone-2.experiment.html: the paper's table 3 and figures 10 to 12 beside ours, against the paper's benchmark,
    the graph and the truth, the error of the benchmark itself, and the errors of CF over its two parameters.
    """
    _run_experiment("phone-2", None, trials, correction)


def in_hand(
    *,
    hand: str | None = None,
    minutes: float | None = None,
    correction: Correction = AS_RECORDED,
    trials: Trials = SIMULATED,
) -> None:
    """Repeat experiment 3 of Elmi Aziz and Mohseni Araste 2021: a phone in the hand, CF and Kalman filters.

    Writes phone-3.experiment.html: the paper's table 4 and figures 13 to 15 beside ours, against the paper's benchmark,
    the graph and the truth, the error of the benchmark itself, and accuracy and time of the Kalman filters.

    Parameters
    ----------
    hand
        carried (about, and jolted), shaken (evenly in one place), or level (shaken, but not up and down); by default
        all.
    minutes
        Length of the simulated recording of the comparison with Kalman filters, by default 10; the paper's has 120.
    """
    _run_experiment(
        "phone-3", hand, trials, correction, _MINUTES if minutes is None and trials.recording is None else minutes
    )


def _run_experiment(
    name: str, hand: str | None, trials: Trials, correction: Correction, minutes: float | None = None
) -> None:
    """Run an experiment in the hands or over the files that are asked for, write its page and print its table."""
    scenario, files, calibration = EXPERIMENTS[name], trials.files, correction.calibration
    if calibration is not None and not files:
        raise BadParameter("--calibration: corrects your own recordings; give them by --recording")
    trials.refuse(hand=hand, minutes=minutes)
    if hand is not None:
        require_known(hand, scenario.hands, "hand")
    hands = (RECORDED,) if files else tuple(scenario.hands) if hand is None else (hand,)
    long_runs = time_long_run(minutes, hands[0]) if minutes else []
    folder = make_output_dir(trials.out)
    if files:
        made = trials.run(_score_file, [_File(file, calibration or "none") for file in files], "recordings")
    else:
        made = trials.run(_run_trial, [_Job(scenario, hand, seed) for hand in hands for seed in trials.seeds], "trials")
    by_hand = {hand: [one for one in made if one.hand == hand] for hand in hands}
    page = folder / f"{name}.experiment.html"
    words = [f"stillpoint experiment {name}", *([f"--hand {hand}"] if hand else []), trials.words]
    words += [f"--calibration {calibration}"] if calibration else []
    command = " ".join([*words, *([f"--minutes {minutes:g}"] if minutes else [])])
    write_text(page, make_phone_page(scenario, by_hand, long_runs, minutes or 0.0, command))
    if trials.json != STDOUT:
        _print_results(scenario, by_hand, long_runs, minutes or 0.0)
        left_out = [one.name for one in made if one.mag_left_out]
        if left_out:
            print_line(
                f"yaw and heading of the methods are arbitrary in {len(left_out)} of {len(made)} recordings: the "
                "magnetometer is not calibrated; add --calibration reference, or compare roll, pitch and tilt only"
            )
        print_line(page)
    rows = [row for one in made for row in _list_facts(one)]
    write_json(trials.json, rows + [{"minutes": minutes, **asdict(run)} for run in long_runs])


def _score_file(file: _File) -> Trial:
    """Return the scores of a recording, corrected where a calibration was asked for."""
    recording, digest = open_recording(file.path), sha256(file.path)
    known = find_calibration(file.calibration, recording, file.path, digest, (file.path.parent,))
    return score_trial(recording, corrected=None if known is None else apply_calibration(recording, known, digest))


def _run_trial(job: _Job) -> Trial:
    return run_trial(job.scenario, job.hand, job.seed)


def _print_results(
    scenario: Scenario, by_hand: Mapping[str, Sequence[Trial]], long_runs: Sequence[LongRun], minutes: float
) -> None:
    """Print the errors of all methods and judges, and what they do over a long recording."""
    trials = len(next(iter(by_hand.values())))
    rows = [*make_method_rows(scenario, by_hand), *make_judge_rows(by_hand)]
    sections: list[list[list[str]]] = []
    for row in rows:
        if row["first"]:
            sections.append([])
        sections[-1].append(_format_cells(row))
    print_table(
        f"{scenario.name}: mean of {trials} {'recordings' if RECORDED in by_hand else 'trials'}, RMSE / largest error",
        _COLUMNS,
        sections,
        texts=3,
    )
    for run in long_runs:
        cf, gain = long_runs[0], PRINTED_KALMAN_GAIN
        print_line(
            f"{minutes:g} min {run.method} ({run.estimator}): tilt {run.tilt_rmse_deg:.2f}, heading "
            f"{run.heading_rmse_deg:.2f} deg over the moving samples, better than {cf.method} by "
            f"{cf.tilt_rmse_deg - run.tilt_rmse_deg:.2f} and {cf.heading_rmse_deg - run.heading_rmse_deg:.2f}; "
            f"{run.ns_per_sample:.0f} ns per sample, {run.ns_per_sample / cf.ns_per_sample:.1f} times {cf.method}'s "
            f"(the paper's Kalman filter: by {gain.tilt_deg:g} and {gain.heading_deg:g}, {gain.time_ratio:g} times)"
        )


def _format_cells(row: Mapping[str, Any]) -> list[str]:
    """Return a row as text: RMSE / largest error of each Euler angle, then the other errors; deg."""
    pairs = zip(row["euler"][::2], row["euler"][1::2], strict=True)
    beside = ["-" if value is None else f"{value:.2f}" for value in row["beside"]]
    return [row["hand"], row["judge"], row["method"], *(f"{rmse:.2f} / {most:.1f}" for rmse, most in pairs), *beside]


def _list_facts(one: Trial) -> list[dict[str, Any]]:
    """Return the scores of a trial for ``--json``, and the drift of its gyro."""
    place = {"hand": one.hand, "recording": one.name}
    scored = [
        {**score_row(score), **place, "method": method, "against": judge}
        for (method, judge), score in one.scores.items()
    ]
    drift = dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), one.drift_deg, strict=True))
    return [*scored, {**place, "method": "Gyro", "drift_in_a_minute": drift}]
