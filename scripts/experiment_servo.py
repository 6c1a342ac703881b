"""``stillpoint experiment servo-bench``: paper 004's bench."""

from dataclasses import asdict, dataclass
from pathlib import Path

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.scoring.servo_page import rows, servo_page
from stillpoint.scoring.servo_study import Trial, trial
from stillpoint.scripts.flags import Jobs, OutDir, Whole
from stillpoint.scripts.inputs import output_dir
from stillpoint.scripts.jobs import run_jobs
from stillpoint.scripts.json_file import STDOUT, JsonFile, write_json
from stillpoint.scripts.tables import print_table
from stillpoint.scripts.text_file import write_text

COLUMNS = ("roll by", "rms at rest, deg", "low rate", "high rate")
SHORTEST_MINUTES = 3.5  # a rest, and a minute of swings at each rate


@dataclass(frozen=True)
class _Job:
    seed: int
    minutes: float


def bench(
    *,
    minutes: float = 30.0,
    trials: Whole = 5,
    seed: Whole = 0,
    out: OutDir = Path(),
    jobs: Jobs = None,
    json: JsonFile = None,
) -> None:
    """Roll of a board on a servo by gyro, by accelerometer and by the Kalman filter of angle and bias.

    Writes servo-bench.experiment.html: the paper's figures 4 to 7 redrawn, and its drift beside ours.

    Parameters
    ----------
    minutes
        Length of each bench.
    trials
        How many benches, each with a unit of its own, with rising seeds.
    seed
        Seed of the first.
    out
        Folder to write into; made when it is not there.
    jobs
        Processes; by default one per core.
    json
        Also write every figure as JSON to this file; - is the standard output.
    """
    if trials < 1 or seed < 0:
        raise BadParameter(f"--trials {trials} --seed {seed}: give 1 bench or more, and a seed from 0 on")
    if minutes < SHORTEST_MINUTES:
        raise BadParameter(f"--minutes {minutes:g}: give {SHORTEST_MINUTES:g} or more, for swings at both rates")
    folder = output_dir(out)
    outcomes = run_jobs(_trial, [_Job(seed + k, minutes) for k in range(trials)], jobs, "benches")
    failed = next((outcome.error for outcome in outcomes if outcome.value is None), None)
    if failed is not None:
        raise StillpointError(failed)
    made = [outcome.value for outcome in outcomes if outcome.value is not None]
    page = folder / "servo-bench.experiment.html"
    command = f"stillpoint experiment servo-bench --minutes {minutes:g} --trials {trials} --seed {seed}"
    write_text(page, servo_page(made, command))
    if json != STDOUT:
        print_table(f"servo-bench: {trials} benches", COLUMNS, [[[row["method"], *row["cells"]] for row in rows(made)]])
        print(page)
    write_json(json, [{"seed": one.seed, **asdict(one.figures)} for one in made])


def _trial(job: _Job) -> Trial:
    return trial(job.seed, job.minutes)
