"""``stillpoint experiment servo-bench``: the bench of Byambajav et al."""

from dataclasses import asdict, dataclass
from pathlib import Path

from stillpoint.datasets.errors import BadParameter
from stillpoint.scripts.shared.inputs import make_output_dir
from stillpoint.scripts.shared.output import STDOUT, print_line, write_json, write_text
from stillpoint.scripts.shared.recordings import open_recording
from stillpoint.scripts.shared.tables import print_table
from stillpoint.scripts.verbs.experiments.trials import SIMULATED, Trials
from stillpoint.studies.papers.servo.page import make_rows, make_servo_page
from stillpoint.studies.papers.servo.study import Trial, run_trial, score_recording

_COLUMNS = ("against", "angle", "by", "rms at rest, deg", "low rate", "high rate")
_MINUTES = 30.0
_SHORTEST_MINUTES = 3.5  # a rest, and a minute of swings at each rate


@dataclass(frozen=True)
class _Job:
    """A simulated bench to score."""

    seed: int
    minutes: float


def bench(*, minutes: float | None = None, trials: Trials = SIMULATED) -> None:
    """Roll and heading of a board on a servo by gyro, by accelerometer and by the Kalman filter of angle and bias.

    Writes servo-bench.experiment.html: the paper's figures 4 to 7 redrawn, and its drift beside ours. Each trial is a
    bench with a unit of its own.

    Parameters
    ----------
    minutes
        Length of each simulated bench, by default 30.
    """
    files = trials.files
    trials.refuse(minutes=minutes)
    long_min = _MINUTES if minutes is None else minutes
    if long_min < _SHORTEST_MINUTES:
        raise BadParameter(f"--minutes {long_min:g}: give {_SHORTEST_MINUTES:g} or more, for swings at both rates")
    folder = make_output_dir(trials.out)
    if files:
        made = [one for some in trials.run(_score_file, files, "recordings") for one in some]
    else:
        made = trials.run(_run_trial, [_Job(seed, long_min) for seed in trials.seeds], "benches")
    page = folder / "servo-bench.experiment.html"
    length = "" if files else f"--minutes {long_min:g} "
    write_text(page, make_servo_page(made, f"stillpoint experiment servo-bench {length}{trials.words}", bool(files)))
    if trials.json != STDOUT:
        table = [[row["judge"], row["angle"], row["method"], *row["cells"]] for row in make_rows(made)]
        print_table(f"servo-bench: {len(files) or len(made)} benches", _COLUMNS, [table], texts=3)
        print_line(page)
    write_json(trials.json, [{"recording": one.name, "against": one.judge, **asdict(one.figures)} for one in made])


def _run_trial(job: _Job) -> Trial:
    return run_trial(job.seed, job.minutes)


def _score_file(file: Path) -> list[Trial]:
    return score_recording(open_recording(file))
