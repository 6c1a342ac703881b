"""The leaderboard as one call: make what is missing, reuse what is there, and rank."""

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from stillpoint.datasets import write
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.files.result_store import ResultStore, get_product_version
from stillpoint.datasets.recording import Recording
from stillpoint.scoring import AlignKind
from stillpoint.studies.job_runner import JobRunner, run_here
from stillpoint.studies.leaderboard.board import Leaderboard, Run, Source, Table
from stillpoint.studies.leaderboard.cells import Line, has_missing, list_lines, make_estimates, plan_cells, score_cells
from stillpoint.studies.leaderboard.entrants import Entrant, Own, find_entrants, find_labels, list_default_estimators
from stillpoint.studies.leaderboard.files import drop_trajectories
from stillpoint.studies.leaderboard.judges import TRUTH, find_judge, needs_reference
from stillpoint.studies.leaderboard.ranking import build_tables
from stillpoint.studies.leaderboard.references import References, find_references
from stillpoint.studies.leaderboard.series import RESULTS
from stillpoint.studies.leaderboard.sources import survey_sources
from stillpoint.studies.leaderboard.study import NONE, REFERENCE, Against, Study

_LEAST_IN_GROUP = 2  # recordings of a tag or device that get a table of their own


def leaderboard(
    recordings: Sequence[Path | str | Recording],
    estimators: Sequence[str | Own] = (),
    out: Path | str | None = None,
    *,
    params: Mapping[str, Mapping[str, object]] | None = None,
    against: Against = "auto",
    align: AlignKind = "heading",
    calibration: Sequence[str] = (NONE,),
    groups: Sequence[str] | None = None,
    run_jobs: JobRunner = run_here,
) -> Leaderboard:
    """Score estimators over recordings and say which are better.

    Parameters
    ----------
    recordings
        MCAP files, or recordings in memory.
    estimators
        Names of the table of estimators (``all`` for every one of attitude), ``NAME@FILE.toml`` with parameters of
        ``stillpoint tune``, ``FILE.py:NAME`` or ``MODULE:NAME`` of one's own, names of entry points, labels of files
        beside the recordings, or functions and classes. Empty: all of the table. Files beside the recordings
        (``NAME.LABEL.tum``) always take part.
    out
        Folder for references and results; a second call with it computes only what changed. None: nothing is kept.
    params
        Parameters by estimator that differ from the defaults.
    against
        ``"auto"``: independent truth where a recording has it, the reference elsewhere; ``"truth"``,
        ``"reference"``, or ``"both"`` with a table for each.
    align
        What may differ without being an error, as for :func:`stillpoint.scoring.score`.
    calibration
        ``"none"``: samples as recorded. ``"reference"``: corrected by what the reference found about the sensor. Or a
        file with a calibration. Each gives its own rows.
    groups
        Tags and devices that get a table of their own; None: all.
    run_jobs
        How to run jobs; by default one after another in this process.

    Raises
    ------
    BadParameter
        For an option or estimator that does not exist. What fails on a recording is an entry with its error instead.
    """
    objects = [each for each in estimators if not isinstance(each, str)]
    with _open_folder(out) as folder:
        study = Study(
            recordings=tuple(str(_find_file(each, folder)) for each in recordings),
            estimators=tuple(each for each in estimators if isinstance(each, str)),
            params=params or {},
            against=against,
            align=align,
            calibration=tuple(calibration),
            groups=None if groups is None else tuple(groups),
        )
        return run_study(study, folder, run_jobs, objects)


def find_study_entrants(study: Study, objects: Sequence[Own] = ()) -> list[Entrant]:
    """Return the entrants of a study, with estimators that were given from Python; writes nothing.

    Raises :class:`BadParameter` for an estimator or a parameter that does not exist.
    """
    wanted: list[str | Own] = [*study.estimators, *objects] or list(list_default_estimators())
    files = drop_trajectories([Path(name) for name in study.recordings])
    return find_entrants(wanted, find_labels(files), study.params)


def run_study(
    study: Study,
    out: Path,
    run_jobs: JobRunner = run_here,
    objects: Sequence[Own] = (),
    publish: Callable[[Leaderboard], None] | None = None,
) -> Leaderboard:
    """Run a study whose recordings are files; results are kept in ``out``.

    ``objects`` are estimators given from Python. Where slow estimators (loops in Python) are among others,
    ``publish`` gets the leaderboard of the fast ones before the slow ones are run.
    """
    entrants = find_study_entrants(study, objects)
    store = ResultStore(out / RESULTS)
    files = drop_trajectories([Path(name) for name in study.recordings])
    sources = survey_sources(files, store)
    _require_unchanged(study, sources)
    complete = replace(
        study,
        recordings=tuple(map(str, files)),
        estimators=tuple(entrant.spelling for entrant in entrants),
        sha256={source.recording: source.sha256 for source in sources if source.sha256},
    )
    needed = [source for source in sources if needs_reference(source, study.against, study.calibration)]
    references = find_references(needed, out, store, run_jobs)
    fast, slow = ([each for each in entrants if each.slow is kind] for kind in (False, True))
    if publish is not None and fast and has_missing(sources, list_lines(slow, study.calibration), references, store):
        publish(_compare(complete, sources, list_lines(fast, study.calibration), references, store, run_jobs))
    return _compare(complete, sources, list_lines(entrants, study.calibration), references, store, run_jobs)


def _compare(
    study: Study,
    sources: Sequence[Source],
    lines: Sequence[Line],
    references: References,
    store: ResultStore,
    run_jobs: JobRunner,
) -> Leaderboard:
    """Make what is missing of these lines, score and rank them."""
    cells = make_estimates(list(plan_cells(sources, lines, references, store)), store, run_jobs)
    rows = [line.empty_row() for line in lines]
    tables: list[Table] = []
    groups: list[Table] = []
    runs: list[Run] = []
    for against in (TRUTH, REFERENCE) if study.against == "both" else (study.against,):
        judges = {s.recording: find_judge(s, against, study.against == "both", references) for s in sources}
        scored = score_cells(cells, judges, study.align, store, run_jobs)
        tables += build_tables("", scored, sources, rows)
        for name, members in _list_groups(sources, study.groups):
            groups += build_tables(name, scored, members, rows)
        runs += scored.runs.values()
    return Leaderboard(
        against="both" if study.against == "both" else tables[0].against,
        align=study.align,
        tables=tuple(tables),
        groups=tuple(table for table in groups if len(table.recordings) >= _LEAST_IN_GROUP),
        runs=tuple(runs),
        sources=tuple(sources),
        version=get_product_version(),
        study=study.as_dict(),
    )


def _list_groups(sources: Sequence[Source], wanted: Sequence[str] | None) -> Iterator[tuple[str, list[Source]]]:
    """Return tags and devices with the recordings that share them; those that all recordings share say nothing."""
    names = dict.fromkeys(name for source in sources for name in (*source.tags, source.device) if name)
    for name in names if wanted is None else wanted:
        members = [source for source in sources if name in (*source.tags, source.device)]
        if wanted is not None and not members:
            known = ", ".join(names) or "no tag or device"
            raise BadParameter(f"group {name!r}: no recording has this tag or device; there is {known}")
        if len(members) < len(sources):
            yield name, members


def _require_unchanged(study: Study, sources: Sequence[Source]) -> None:
    """Raise :class:`BadParameter` when a recording is not the one that the study was made with."""
    for source in sources:
        wanted = study.sha256.get(source.recording)
        if wanted is not None and source.sha256 not in ("", wanted):
            raise BadParameter(
                f"{source.file}: has changed since the study was made (another SHA-256); "
                "use the same file, or remove [sha256] from the study"
            )


@contextmanager
def _open_folder(out: Path | str | None) -> Iterator[Path]:
    """Yield the folder for results; a temporary one where none is named."""
    if out is not None:
        yield Path(out)
        return
    with tempfile.TemporaryDirectory(prefix="stillpoint-") as name:
        yield Path(name)


def _find_file(recording: Path | str | Recording, folder: Path) -> Path:
    """Return the file of a recording; one in memory is written to the folder of results."""
    if not isinstance(recording, Recording):
        return Path(recording)
    file = folder / "recordings" / f"{recording.name}.mcap"
    file.parent.mkdir(parents=True, exist_ok=True)
    write(file, recording)
    return file
