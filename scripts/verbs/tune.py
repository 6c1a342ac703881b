"""``stillpoint tune``: find the parameters with which an estimator errs least over many recordings."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from stillpoint.datasets.errors import BadParameter
from stillpoint.scoring.align import AlignKind
from stillpoint.scoring.report.printed import save_figure
from stillpoint.scripts.shared import inputs
from stillpoint.scripts.shared.children import Outcome
from stillpoint.scripts.shared.flags import LOCAL, Inputs, Whole, Workers
from stillpoint.scripts.shared.jobs import run_jobs
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_document, write_text
from stillpoint.scripts.shared.tables import print_table
from stillpoint.studies.leaderboard.study import Against
from stillpoint.studies.tune import ParamRange, Sampler, Tuning, forget_trials, format_tuning
from stillpoint.studies.tune import tune as tune_estimator
from stillpoint.studies.tune_figure import draw_tuning

_COLUMNS = ("recording", "defaults", "common", "own best", "left out")


def tune(
    paths: Inputs,
    /,
    *,
    estimator: Annotated[str, Parameter(name=["--estimators", "-e", "--estimator"])],
    param: Annotated[list[str], Parameter(negative=())],
    save: Path | None = None,
    out: Annotated[Path, Parameter(name=["--out", "-o"])] = Path("tune"),
    sampler: Sampler = "tpe",
    trials: Whole = 60,
    steps: Whole = 9,
    seed: Whole = 0,
    against: Against = "auto",
    align: AlignKind = "heading",
    calibration: str = "none",
    seconds: float | None = None,
    workers: Workers = LOCAL,
    force: Annotated[bool, Parameter(negative=())] = False,
    json: JsonFile = None,
) -> int:
    """Find the parameters with which an estimator errs least over many recordings.

    Prints the RMSE of each recording with the defaults, with the best common setting, with the recording's own best
    setting, and with the setting that is best on the others. Trials are kept: a second run goes on where the first one
    stopped, and several runs may share an output folder. Needs the extra tune.

    Parameters
    ----------
    paths
        Recordings: MCAP files, folders or globs.
    estimator
        The estimator, one at a time; names as for estimate.
    param
        A parameter and its range, NAME=LOW:HIGH or NAME=LOW:HIGH:log, for example omega0_radps=0.02:2:log; can be
        given several times.
    save
        A TOML file for the common setting; -e ESTIMATOR@FILE.toml of leaderboard uses it.
    out
        Folder for trials, ESTIMATOR.tune.json and the map ESTIMATOR.map.png.
    sampler
        How settings are chosen: tpe (learns from those before), random, or grid.
    trials
        How many settings are tried; a grid has its own number. Without --jobs one process tries them all.
    steps
        Values per parameter of a grid.
    seed
        Of the sampler.
    against
        What judges: truth, reference, or by default (auto) truth where a recording has it, the reference elsewhere.
    align
        What may differ without being an error, as for score.
    calibration
        Input of the estimator: none, reference or a file, as for leaderboard.
    seconds
        Run the estimator over only so many seconds of motion of each recording, where it is too slow for all of it
        (madgwick takes minutes a recording).
    force
        Delete the trials and results in the output folder and start again.
    json
        Also write all trials as JSON to this file; - is the standard output.
    """
    if against == "both":
        raise BadParameter("--against both: tuning needs one judge for each recording; give truth, reference or auto")
    if "," in estimator:
        raise BadParameter(f"--estimators {estimator}: tune takes one at a time, as each has parameters of its own")
    ranges = [ParamRange.parse(text) for text in param]

    def run(function: Callable[[Any], Any], items: Sequence[Any], what: str) -> list[Outcome[Any]]:
        return run_jobs(function, items, workers, what)

    folder = inputs.make_output_dir(out)
    if force:
        forget_trials(folder, estimator)
    tuning = tune_estimator(
        inputs.find_recordings(paths),
        estimator,
        ranges,
        folder,
        sampler=sampler,
        trials=trials,
        steps=steps,
        seed=seed,
        against=against,
        align=align,
        calibration=calibration,
        seconds=seconds,
        workers=workers.jobs or 1,
        run_jobs=run,
    )
    if tuning.new_trials == 0:
        kept = "all trials are kept from an earlier run, nothing to try (--force begins again)"
        print_line(f"tune: {kept}", file=sys.stderr)
    write_document(str(folder / f"{estimator}.tune.json"), tuning.to_json())
    save_figure(draw_tuning(tuning), folder / f"{estimator}.map.png", dpi=150, metadata={"Software": None})
    if save is not None:
        write_text(save, format_tuning(tuning))
    write_document(json, tuning.to_json())
    if json != STDOUT:
        _print_tuning(tuning)
        saved = f"; {save}" if save is not None else ""
        print_line(f"written to {folder}: {estimator}.tune.json, {estimator}.map.png{saved}")
    return 0


def _print_tuning(tuning: Tuning) -> None:
    """Print a row per recording, the means, and the common setting."""
    columns = (
        tuning.defaults.rmse_deg,
        tuning.best.rmse_deg,
        [trial.rmse_deg[k] for k, trial in enumerate(tuning.best_per_recording)],
        tuning.left_out_deg,
    )
    rows = [[name, *(f"{column[k]:.2f}" for column in columns)] for k, name in enumerate(tuning.recordings)]
    means = ["mean", *(f"{np.mean(column):.2f}" for column in columns)]
    title = f"{tuning.estimator}: {tuning.figure} RMSE in deg after {len(tuning.trials)} trials"
    print_table(title, _COLUMNS, [rows, [means]], texts=1)
    setting = ", ".join(f"{name} = {value:.4g}" for name, value in tuning.best.params.items())
    print_line(
        f"common setting: {setting} (typical {tuning.best.typical_deg:.2f}, defaults {tuning.defaults.typical_deg:.2f})"
    )
    print_line(f"{tuning.tuned_on}; 'left out' is each recording with the setting chosen on the others")
