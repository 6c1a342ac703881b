"""``stillpoint experiment servo-bench``: the bench of Byambajav et al."""

from dataclasses import asdict, dataclass

from stillpoint.datasets.errors import BadParameter
from stillpoint.scripts.shared.inputs import output_dir
from stillpoint.scripts.shared.output import STDOUT, print_line, write_json, write_text
from stillpoint.scripts.shared.tables import print_table
from stillpoint.scripts.verbs.experiments.trials import FIVE, Trials
from stillpoint.studies.papers.servo.page import make_rows, servo_page
from stillpoint.studies.papers.servo.study import Trial, run_trial

COLUMNS = ("angle", "by", "rms at rest, deg", "low rate", "high rate")
SHORTEST_MINUTES = 3.5  # a rest, and a minute of swings at each rate


@dataclass(frozen=True)
class _Job:
    seed: int
    minutes: float


def bench(*, minutes: float = 30.0, trials: Trials = FIVE) -> None:
    """Roll and heading of a board on a servo by gyro, by accelerometer and by the Kalman filter of angle and bias.

    Writes servo-bench.experiment.html: the paper's figures 4 to 7 redrawn, and its drift beside ours. Each trial is a
    bench with a unit of its own.

    Parameters
    ----------
    minutes
        Length of each bench.
    """
    if minutes < SHORTEST_MINUTES:
        raise BadParameter(f"--minutes {minutes:g}: give {SHORTEST_MINUTES:g} or more, for swings at both rates")
    work = [_Job(seed, minutes) for seed in trials.seeds]
    folder = output_dir(trials.out)
    made = trials.run(_run_trial, work, "benches")
    page = folder / "servo-bench.experiment.html"
    write_text(page, servo_page(made, f"stillpoint experiment servo-bench --minutes {minutes:g} {trials.words}"))
    if trials.json != STDOUT:
        table = [[row["angle"], row["method"], *row["cells"]] for row in make_rows(made)]
        print_table(f"servo-bench: {trials.trials} benches", COLUMNS, [table], texts=2)
        print_line(page)
    write_json(trials.json, [{"seed": one.seed, **asdict(one.figures)} for one in made])


def _run_trial(job: _Job) -> Trial:
    return run_trial(job.seed, job.minutes)
