"""``stillpoint experiment auv-dolphin``: the mission of Zia 2022."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.scripts.shared.inputs import make_output_dir
from stillpoint.scripts.shared.output import STDOUT, print_line, write_json, write_text
from stillpoint.scripts.shared.recordings import open_recording
from stillpoint.scripts.shared.tables import print_table
from stillpoint.scripts.verbs.experiments.trials import FIRST_ONLINE, SIMULATED, Trials
from stillpoint.studies.papers.auv.page import COLUMNS, make_auv_page
from stillpoint.studies.papers.auv.study import (
    METHODS,
    RECORDED,
    SEAS,
    SeaKind,
    Trial,
    run_trial,
    score_recording,
    summarise_trials,
)

Online = Annotated[bool, Parameter(negative=())]


@dataclass(frozen=True)
class _Job:
    """A simulated mission to score."""

    sea: SeaKind
    seed: int
    online: bool


@dataclass(frozen=True)
class _File:
    """A recording to score."""

    file: Path
    online: bool


def dolphin(*, online: Online = False, sea: SeaKind | None = None, trials: Trials = SIMULATED) -> None:
    """Roll, pitch, heading and gains of an underwater vehicle over a mission with 600 s under water.

    Writes auv-dolphin.experiment.html (online: auv-dolphin-online.experiment.html): the paper's figures 4 to 11
    redrawn, and the numbers of its tables beside those of the complementary filters, the Kalman filter and the gyro.

    Parameters
    ----------
    online
        As on a microcontroller: fed sample by sample in single precision; simulated missions have seeds of their own,
        from 10 on.
    sea
        waves, or calm (the vehicle rolls as much, but is not thrown about); by default both.
    """
    files = trials.files
    trials.refuse(sea=sea)
    if online and not files and trials.seed is None:
        trials = replace(trials, seed=FIRST_ONLINE)
    folder = make_output_dir(trials.out)
    if files:
        seas: tuple[str, ...] = (RECORDED,)
        made = trials.run(_score_file, [_File(file, online) for file in files], "recordings")
    else:
        kinds = SEAS if sea is None else (sea,)
        seas, work = kinds, [_Job(kind, seed, online) for kind in kinds for seed in trials.seeds]
        made = trials.run(_run_trial, work, "missions")
    by_sea = {kind: [one for one in made if one.sea == kind] for kind in seas}
    name = f"auv-dolphin{'-online' if online else ''}"
    page = folder / f"{name}.experiment.html"
    words = ["stillpoint experiment auv-dolphin", *(["--online"] if online else []), *([f"--sea {sea}"] if sea else [])]
    write_text(page, make_auv_page(by_sea, online, " ".join([*words, trials.words])))
    if trials.json != STDOUT:
        columns = ("sea", "method", *(f"{column.name}, {column.unit}" for column in COLUMNS))
        title = f"{name}: {len(made)} recordings" if files else f"{name}: {len(trials.seeds)} missions per sea"
        print_table(title, columns, [_make_rows(some) for some in by_sea.values()])
        print_line(page)
    write_json(trials.json, [row for one in made for row in _list_facts(one)])


def _run_trial(job: _Job) -> Trial:
    return run_trial(job.sea, job.seed, job.online)


def _score_file(job: _File) -> Trial:
    return score_recording(open_recording(job.file), job.online)


def _make_rows(trials: list[Trial]) -> list[list[str]]:
    """Return the rows of the table: the summary of each method over the trials."""
    return [
        [trials[0].sea, method.name]
        + [f"{summarise_trials(trials, method.name, column.key):.2g}" for column in COLUMNS]
        for method in METHODS
    ]


def _list_facts(one: Trial) -> list[dict[str, Any]]:
    """Return the figures of a trial for ``--json``, one row per method."""
    return [
        {"sea": one.sea, "recording": one.name, "method": method, **asdict(figures)}
        for method, figures in one.figures.items()
    ]
