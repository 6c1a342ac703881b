"""``stillpoint experiment auv-dolphin``: paper 003's mission."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.scoring.auv_page import COLUMNS, auv_page
from stillpoint.scoring.auv_study import METHODS, SEAS, SeaKind, Trial, over_trials, trial
from stillpoint.scripts.flags import Jobs, OutDir, Whole
from stillpoint.scripts.inputs import output_dir
from stillpoint.scripts.jobs import run_jobs
from stillpoint.scripts.json_file import STDOUT, JsonFile, write_json
from stillpoint.scripts.tables import print_table
from stillpoint.scripts.text_file import write_text

Online = Annotated[bool, Parameter(negative=())]


@dataclass(frozen=True)
class _Job:
    sea: SeaKind
    seed: int
    online: bool


def dolphin(
    *,
    online: Online = False,
    sea: SeaKind | None = None,
    trials: Whole = 5,
    seed: Whole = 0,
    out: OutDir = Path(),
    jobs: Jobs = None,
    json: JsonFile = None,
) -> None:
    """Roll, pitch, heading and gains of an underwater vehicle over a mission with 600 s under water.

    Writes auv-dolphin.experiment.html (online: auv-dolphin-online.experiment.html): the paper's figures 6 to 11
    redrawn, and the numbers of its tables beside those of the complementary filters, the Kalman filter and the gyro.

    Parameters
    ----------
    online
        In single precision, as on a microcontroller.
    sea
        waves, or calm (the vehicle rolls as much, but is not thrown about); by default both.
    trials
        How many missions per sea, with rising seeds.
    seed
        Seed of the first mission.
    out
        Folder to write into; made when it is not there.
    jobs
        Processes; by default one per core.
    json
        Also write every figure as JSON to this file; - is the standard output.
    """
    if trials < 1 or seed < 0:
        raise BadParameter(f"--trials {trials} --seed {seed}: give 1 mission or more, and a seed from 0 on")
    seas = SEAS if sea is None else (sea,)
    folder = output_dir(out)
    outcomes = run_jobs(
        _trial, [_Job(kind, seed + k, online) for kind in seas for k in range(trials)], jobs, "missions"
    )
    failed = next((outcome.error for outcome in outcomes if outcome.value is None), None)
    if failed is not None:
        raise StillpointError(failed)
    made = [outcome.value for outcome in outcomes if outcome.value is not None]
    by_sea = {kind: [one for one in made if one.sea == kind] for kind in seas}
    name = f"auv-dolphin{'-online' if online else ''}"
    page = folder / f"{name}.experiment.html"
    write_text(page, auv_page(by_sea, online, _command(online, sea, trials, seed)))
    if json != STDOUT:
        columns = ("sea", "method", *(f"{column.name}, {column.unit}" for column in COLUMNS))
        print_table(f"{name}: {trials} missions per sea", columns, [_rows(some) for some in by_sea.values()])
        print(page)
    write_json(json, [row for one in made for row in _facts(one)])


def _trial(job: _Job) -> Trial:
    return trial(job.sea, job.seed, job.online)


def _rows(trials: list[Trial]) -> list[list[str]]:
    return [
        [trials[0].sea, method.name] + [f"{over_trials(trials, method.name, column.key):.2g}" for column in COLUMNS]
        for method in METHODS
    ]


def _facts(one: Trial) -> list[dict[str, Any]]:
    return [
        {"sea": one.sea, "seed": one.seed, "method": method, **asdict(figures)}
        for method, figures in one.figures.items()
    ]


def _command(online: bool, sea: SeaKind | None, trials: int, seed: int) -> str:
    words = ["stillpoint experiment auv-dolphin", *(["--online"] if online else []), *([f"--sea {sea}"] if sea else [])]
    return " ".join([*words, f"--trials {trials} --seed {seed}"])
