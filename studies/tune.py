"""Find the parameters of an estimator with which it errs least over many recordings.

The common setting is the one with the least typical RMSE over all recordings (what BROAD calls TAGP: one set for all
trials). Beside it stand the best setting of each recording alone, which nobody can know before, and what is left when
each recording is scored with the setting chosen on the others. All three are read from one table of trials.
"""

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from stillpoint.datasets.calibration.apply import apply_calibration, load_calibration
from stillpoint.datasets.cut import cut_recording
from stillpoint.datasets.errors import BadParameter, StillpointError, Unobservable, require_known
from stillpoint.datasets.files.result_store import ResultStore, get_product_version
from stillpoint.datasets.mcap.store import read_recording
from stillpoint.datasets.recording import Floats, Recording, Truth
from stillpoint.datasets.settings import choose_settings
from stillpoint.datasets.trajectory import Reference
from stillpoint.filters import estimate
from stillpoint.filters.table import ATTITUDES, ESTIMATORS
from stillpoint.scoring import AlignKind, compare
from stillpoint.scoring.errors import compute_attitude_error
from stillpoint.scoring.match import Mask
from stillpoint.studies.job_runner import JobRunner, run_here
from stillpoint.studies.leaderboard.board import RankedBy, Source
from stillpoint.studies.leaderboard.cells import find_calibration
from stillpoint.studies.leaderboard.estimates import LEFT_OUT
from stillpoint.studies.leaderboard.files import drop_trajectories
from stillpoint.studies.leaderboard.judges import find_judge, load_judge, needs_reference
from stillpoint.studies.leaderboard.references import References, find_references
from stillpoint.studies.leaderboard.series import RESULTS
from stillpoint.studies.leaderboard.sources import number_rows, survey_sources
from stillpoint.studies.leaderboard.study import AGAINST, NONE, Against
from stillpoint.studies.leaderboard.verdicts import merge_rows

Sampler = Literal["tpe", "random", "grid"]
_LEAD_S = 5.0  # before the first motion, for an estimator to start
_JUDGED_HZ = 25.0  # stamps of a judge that are compared: RMSE over more differ by 0.02 %
_RMSE_ATTRIBUTE = "rmse_deg"  # of a trial: one value per recording


@dataclass(frozen=True)
class ParamRange:
    """The values of one parameter that are tried."""

    name: str
    low: float
    high: float
    log: bool = False

    @classmethod
    def parse(cls, text: str) -> "ParamRange":
        """Return the range of ``NAME=LOW:HIGH`` or ``NAME=LOW:HIGH:log``; raises :class:`BadParameter`."""
        name, equals, ends = text.partition("=")
        parts = ends.split(":")
        try:
            low, high = float(parts[0]), float(parts[1])
            scale = parts[2] if len(parts) == 3 else "linear"
        except (ValueError, IndexError):
            equals = ""
        if not equals or not name.strip() or len(parts) > 3 or scale not in ("log", "linear"):
            raise BadParameter(f"--param {text}: write NAME=LOW:HIGH or NAME=LOW:HIGH:log")
        if not low < high or (scale == "log" and low <= 0):
            raise BadParameter(f"--param {text}: LOW must be below HIGH, and above 0 with :log")
        return cls(name.strip(), low, high, scale == "log")

    def make_grid(self, steps: int) -> list[float]:
        """Return ``steps`` values over the range."""
        spaced = np.geomspace if self.log else np.linspace
        return [float(value) for value in spaced(self.low, self.high, steps)]


@dataclass(frozen=True)
class _TuneSpec:
    """The parameters and recordings of one tuning; it can be pickled."""

    estimator: str
    ranges: tuple[ParamRange, ...]
    sources: tuple[Source, ...]
    references: References
    against: Against
    align: AlignKind
    calibration: str
    sampler: Sampler
    steps: int  # per parameter, of a grid
    trials: int
    seed: int
    journal: Path
    seconds: float | None = None  # of motion in each recording; None: all of it

    def __str__(self) -> str:
        return f"trials of {self.estimator}"

    @property
    def study_name(self) -> str:
        """The name under which trials are kept: another input, range or product has another name."""
        deciding = [
            get_product_version(),
            self.estimator,
            [asdict(each) for each in self.ranges],
            [source.sha256 for source in self.sources],
            [self.against, self.align, self.calibration, self.sampler, self.steps if self.sampler == "grid" else 0],
            self.seconds,
        ]
        return hashlib.sha256(json.dumps(deciding).encode()).hexdigest()


@dataclass(frozen=True)
class TunedTrial:
    """One setting and the RMSE it gave, in deg per recording."""

    params: Mapping[str, float]
    rmse_deg: tuple[float, ...]
    typical_deg: float  # geometric mean; recordings of one device and motion count once


@dataclass(frozen=True)
class Tuning:
    """The outcome: the common setting beside what it is to be compared with."""

    estimator: str
    figure: RankedBy  # the error that was made small
    recordings: tuple[str, ...]
    sha256: Mapping[str, str]
    tuned_on: str
    ranges: tuple[ParamRange, ...]
    trials: tuple[TunedTrial, ...]  # in the order in which they were run
    defaults: TunedTrial
    best: TunedTrial  # the common setting
    best_per_recording: tuple[TunedTrial, ...]  # for each recording the trial that suits it best
    left_out_deg: tuple[float, ...]  # each recording with the setting that was chosen on the others
    settings: Mapping[str, Any] = field(default_factory=dict)  # sampler, alignment, judge, calibration
    new_trials: int = 0  # of this call; the others were kept

    def to_json(self) -> dict[str, Any]:
        """Return plain values for a JSON file."""
        return asdict(self)


def tune(
    recordings: Sequence[Path | str],
    estimator: str,
    ranges: Sequence[ParamRange],
    out: Path | str = "tune",
    *,
    sampler: Sampler = "tpe",
    trials: int = 60,
    steps: int = 9,
    seed: int = 0,
    against: Against = "auto",
    align: AlignKind = "heading",
    calibration: str = NONE,
    seconds: float | None = None,
    workers: int = 1,
    run_jobs: JobRunner = run_here,
) -> Tuning:
    """Tune an estimator of the table over recordings.

    Trials are kept in ``out``/ESTIMATOR.journal: a second call goes on where the first one stopped, and several
    processes may work on one journal. ``workers`` is how many of them ``run_jobs`` starts. With ``seconds`` the
    estimator runs over so much of each recording, from 5 s before its first moving sample; references and
    calibrations are still those of whole recordings.

    Raises :class:`BadParameter` for an unknown estimator or parameter, a range beyond what the parameter allows, and a
    missing package; :class:`Unobservable` when no recording can be judged.
    """
    _require_optuna()
    _check_task(estimator, ranges, against, trials, steps, seconds)
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    store = ResultStore(folder / RESULTS)
    sources = survey_sources(drop_trajectories([Path(file) for file in recordings]), store)
    needed = [source for source in sources if needs_reference(source, against, (calibration,))]
    references = find_references(needed, folder, store, run_jobs)
    judged = tuple(s for s in sources if not isinstance(find_judge(s, against, False, references), str))
    if not judged:
        reasons = {str(find_judge(s, against, False, references)) for s in sources}
        raise Unobservable(f"no recording can be judged: {'; '.join(sorted(reasons))}")
    spec = _TuneSpec(
        estimator=estimator,
        ranges=tuple(ranges),
        sources=judged,
        references=references,
        against=against,
        align=align,
        calibration=calibration,
        sampler=sampler,
        steps=steps,
        trials=steps ** len(ranges) if sampler == "grid" else trials,
        seed=seed,
        journal=folder / f"{estimator}.journal",
        seconds=seconds,
    )
    outcomes = run_jobs(_run_trials, [replace(spec, seed=seed + k) for k in range(max(workers, 1))], "trials")
    errors = [outcome.error for outcome in outcomes if outcome.error]
    if len(errors) == len(outcomes):
        raise StillpointError(errors[0])
    return replace(_summarise(spec), new_trials=sum(outcome.value or 0 for outcome in outcomes))


def forget_trials(out: Path, estimator: str) -> None:
    """Remove the trials of an estimator and all results that :func:`tune` kept in a folder."""
    ResultStore(out / RESULTS).clear()
    (out / f"{estimator}.journal").unlink(missing_ok=True)


def _run_trials(spec: _TuneSpec) -> int:
    """Run trials until the journal holds as many as were asked for; return how many were run here."""
    study = _open_study(spec)
    if _is_done(study, spec):
        return 0
    run = 0
    bench = _Bench(spec)

    def score_trial(trial: Any) -> float:
        """Return the typical RMSE of the setting that the trial suggests."""
        params = {each.name: trial.suggest_float(each.name, each.low, each.high, log=each.log) for each in spec.ranges}
        rmse = bench.evaluate(params)
        nonlocal run
        trial.set_user_attr(_RMSE_ATTRIBUTE, rmse)
        run += 1
        return _average_rmse(rmse, bench.row_of)

    def stop_when_done(study: Any, trial: Any) -> None:
        if _is_done(study, spec):
            study.stop()

    study.optimize(score_trial, callbacks=[stop_when_done])
    return run


class _Bench:
    """Recordings with their judges in memory, to score one setting after another."""

    def __init__(self, spec: _TuneSpec) -> None:
        """Load recordings and judges, and choose the figure: the inclination where no heading can be judged."""
        self.spec = spec
        self.row_of = number_rows(spec.sources)
        self.material = [_load(spec, source) for source in spec.sources]
        self.figure: RankedBy = "total"
        for recording, _, _ in self.material:
            made = estimate(recording, spec.estimator)
            if made.diagnostics.get("heading") == LEFT_OUT:
                self.figure = "inclination"

    def evaluate(self, params: Mapping[str, float]) -> list[float]:
        """Return the RMSE in deg of each recording with these parameters; inf where they cannot be used.

        All moving samples count, also those while the estimator says that it is starting: otherwise a setting that
        starts slowly would be scored on fewer samples.
        """
        rmse = []
        for recording, judge, moving in self.material:
            try:
                made = replace(estimate(recording, self.spec.estimator, params), ready=None)
                compared = compare(made, judge, self.spec.align, moving)
            except StillpointError:
                rmse.append(float("inf"))
                continue
            error = compute_attitude_error(compared.q_est[compared.moving], compared.q_true[compared.moving])
            column = np.rad2deg(getattr(error, f"{self.figure}_rad"))
            rmse.append(float(np.sqrt(np.mean(column**2))))
        return rmse


def _summarise(spec: _TuneSpec) -> Tuning:
    """Read the trials of the journal and choose."""
    bench = _Bench(spec)
    trials = [
        TunedTrial(dict(trial.params), tuple(trial.user_attrs[_RMSE_ATTRIBUTE]), float(trial.value))
        for trial in _list_complete(_open_study(spec))
    ]
    defaults_rmse = bench.evaluate({})
    defaults = TunedTrial(_get_defaults(spec), tuple(defaults_rmse), _average_rmse(defaults_rmse, bench.row_of))
    table = np.array([trial.rmse_deg for trial in trials])
    devices = sorted({source.device or source.source or "unknown device" for source in spec.sources})
    part = "" if spec.seconds is None else f"the first {spec.seconds:g} s of motion of "
    return Tuning(
        estimator=spec.estimator,
        figure=bench.figure,
        recordings=tuple(source.recording for source in spec.sources),
        sha256={source.recording: source.sha256 for source in spec.sources},
        tuned_on=f"tuned on {part}{len(spec.sources)} recordings ({', '.join(devices)})",
        ranges=spec.ranges,
        trials=tuple(trials),
        defaults=defaults,
        best=min(trials, key=lambda trial: trial.typical_deg),
        best_per_recording=tuple(trials[int(k)] for k in table.argmin(axis=0)),
        left_out_deg=tuple(find_left_out(table, bench.row_of)),
        settings={
            "sampler": spec.sampler,
            "align": spec.align,
            "against": spec.against,
            "calibration": spec.calibration,
            "seconds": spec.seconds,
            "stillpoint": get_product_version(),
        },
    )


def find_left_out(rmse_deg: Floats, row_of: Sequence[int]) -> list[float]:
    """Return for each recording its RMSE with the trial that is best on the other rows; ``rmse_deg`` (trials, R).

    All recordings of one row are left out together. With one row there are no others: the result is NaN.
    """
    rows, logs = np.asarray(row_of), np.log(np.maximum(rmse_deg, 1e-6))
    merged = merge_rows(logs.T, row_of)  # (rows, trials)
    left = []
    for k, row in enumerate(rows):
        others = np.delete(merged, row, axis=0)
        left.append(float(rmse_deg[others.mean(0).argmin(), k]) if len(others) else float("nan"))
    return left


def format_tuning(tuning: Tuning) -> str:
    """Return the common setting as TOML, for ``-e ESTIMATOR@FILE.toml``, with how it was found."""
    rest = "nan" if np.isnan(tuning.left_out_deg).any() else f"{np.mean(tuning.left_out_deg):.4g}"
    lines = [
        f"# stillpoint leaderboard -e {tuning.estimator}@FILE.toml uses these parameters.",
        f'estimator = "{tuning.estimator}"',
        f'tuned_on = "{tuning.tuned_on}"',
        "",
        "[params]",
        *(f"{name} = {value!r}" for name, value in tuning.best.params.items()),
        "",
        f"[tuning]  # {tuning.figure} RMSE in deg",
        f"trials = {len(tuning.trials)}",
        f"typical = {tuning.best.typical_deg:.4g}",
        f"typical_with_defaults = {tuning.defaults.typical_deg:.4g}",
        f"mean_left_out = {rest}  # each recording with the setting chosen on the others",
        "",
        "[sha256]",
        *(f'"{name}" = "{digest}"' for name, digest in tuning.sha256.items()),
    ]
    return "\n".join(lines) + "\n"


def _require_optuna() -> None:
    """Raise :class:`BadParameter` where optuna is not installed, and keep it quiet."""
    try:
        import optuna
    except ImportError:
        raise BadParameter("tune needs the package optuna; pip install 'stillpoint[tune]'") from None
    optuna.logging.set_verbosity(optuna.logging.ERROR)


def _check_task(
    estimator: str, ranges: Sequence[ParamRange], against: str, trials: int, steps: int, seconds: float | None
) -> None:
    """Raise :class:`BadParameter` where estimator, ranges, trials or time do not allow a search."""
    require_known(estimator, ATTITUDES, "estimator of attitude")
    require_known(against, AGAINST, "--against")
    if not ranges:
        raise BadParameter(f"no parameter of {estimator} to tune: --param NAME=LOW:HIGH[:log]")
    if trials < 1 or steps < 2:
        raise BadParameter("give at least 1 trial, and 2 steps per parameter of a grid")
    if seconds is not None and not seconds > 0:
        raise BadParameter(f"--seconds {seconds:g}: give a length of time above 0")
    defaults = ESTIMATORS[estimator].params()
    for each in ranges:
        for end in (each.low, each.high):
            choose_settings(defaults, {each.name: end}, estimator)


def _open_study(spec: _TuneSpec) -> Any:
    """Open the study of this spec in the journal, or begin it."""
    import optuna
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    samplers: dict[Sampler, Any] = {
        "tpe": lambda: optuna.samplers.TPESampler(seed=spec.seed),
        "random": lambda: optuna.samplers.RandomSampler(seed=spec.seed),
        "grid": lambda: optuna.samplers.GridSampler(
            {each.name: each.make_grid(spec.steps) for each in spec.ranges}, seed=spec.seed
        ),
    }
    journal = os.fspath(spec.journal)
    return optuna.create_study(
        storage=JournalStorage(JournalFileBackend(journal, lock_obj=JournalFileOpenLock(journal))),
        sampler=samplers[spec.sampler](),
        study_name=spec.study_name,
        load_if_exists=True,
    )


def _is_done(study: Any, spec: _TuneSpec) -> bool:
    """Return whether there are as many trials as asked for; of a grid, whether every point was tried."""
    if spec.sampler == "grid":
        return bool(study.sampler.is_exhausted(study))
    return len(_list_complete(study)) >= spec.trials


def _list_complete(study: Any) -> list[Any]:
    return [trial for trial in study.get_trials(deepcopy=False) if trial.state.name == "COMPLETE"]


def _average_rmse(rmse_deg: Sequence[float], row_of: Sequence[int]) -> float:
    """Return the geometric mean over rows of the RMSE of each recording."""
    logs = np.log(np.maximum(np.array(rmse_deg)[:, None], 1e-6))
    return float(np.exp(merge_rows(logs, row_of).mean()))


def _get_defaults(spec: _TuneSpec) -> dict[str, float]:
    defaults = asdict(ESTIMATORS[spec.estimator].params())
    return {each.name: float(defaults[each.name]) for each in spec.ranges if each.name in defaults}


def _load(spec: _TuneSpec, source: Source) -> tuple[Recording, Reference | Truth, Mask]:
    """Load a recording, calibrated as asked, and its judge at no more than 25 Hz."""
    recording = read_recording(source.file)
    judge_spec = find_judge(source, spec.against, False, spec.references)
    assert not isinstance(judge_spec, str)
    judge = load_judge(judge_spec, recording)
    file = find_calibration(source, spec.calibration, spec.references)
    if file is not None:
        recording = apply_calibration(recording, load_calibration(file), source.sha256)
    t_ns = judge.trajectory.t_ns
    moving = judge.moving
    if spec.seconds is not None:
        begin_ns = int(t_ns[np.argmax(moving)])
        end_ns = begin_ns + round(spec.seconds * 1e9)
        recording = cut_recording(recording, begin_ns - round(_LEAD_S * 1e9), end_ns, recording.name)
        moving = moving & (t_ns <= end_ns)
    rate_hz = 1e9 * (len(t_ns) - 1) / max(int(t_ns[-1] - t_ns[0]), 1)
    step = max(1, int(rate_hz // _JUDGED_HZ))
    kept = slice(None, None, step)
    thin = Truth(t_ns[kept], judge.trajectory.q_nb[kept], moving[kept])
    return recording, thin, moving[kept]
