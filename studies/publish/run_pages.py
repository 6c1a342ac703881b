"""One page for each recording of a leaderboard, made from the results that the leaderboard kept.

No estimator and no reference runs again. A page carries the key of everything that it was made from, and is written
anew only where that has changed.
"""

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import resources
from pathlib import Path
from urllib.parse import quote

from stillpoint.datasets.errors import BadRecording, StillpointError
from stillpoint.datasets.files.atomic import write_atomically
from stillpoint.datasets.files.result_store import ResultStore, make_key
from stillpoint.datasets.mcap.store import read_recording, read_reference, sha256
from stillpoint.datasets.trajectory import Estimate, Reference
from stillpoint.scoring import AlignKind, compare, score_of
from stillpoint.scoring.report.page import Material, Verdict, make_report_html
from stillpoint.scoring.report.templates import PARTS
from stillpoint.studies.job_runner import JobRunner, run_here
from stillpoint.studies.leaderboard.board import Leaderboard, Run, Source
from stillpoint.studies.leaderboard.estimates import load_estimate
from stillpoint.studies.leaderboard.judges import TRUTH, JudgeSpec, judge_by_truth, load_judge
from stillpoint.studies.leaderboard.scores import find_common_samples
from stillpoint.studies.leaderboard.series import RESULTS

_FOLDER = "runs"  # of the pages, in the output folder
_HOME = "../index.html"
_HEAD_BYTES = 1024  # of a page, within which its key stands
_KEY = re.compile(rb'<meta name="made-from" content="([0-9a-f]{64})">')


@dataclass(frozen=True)
class RunPages:
    """Hold the page, or the error, of each recording."""

    links: dict[str, str] = field(default_factory=dict)  # relative to the output folder, quoted for a link
    errors: dict[str, str] = field(default_factory=dict)  # why there is no page


@dataclass(frozen=True)
class _Judged:
    """The runs of one recording that one judge scored."""

    judge: JudgeSpec
    runs: tuple[Run, ...]


@dataclass(frozen=True)
class _PageJob:
    """The page of one recording."""

    source: Source
    judged: tuple[_Judged, ...]
    reference: Path | None  # by which field and bias are shown
    align: AlignKind
    target: Path
    key: str
    store: ResultStore

    def __str__(self) -> str:
        return f"page of {self.source.recording}"


def write_run_pages(out: Path, board: Leaderboard, run_jobs: JobRunner = run_here) -> RunPages:
    """Write the pages that are missing or out of date into ``out``/runs; ``out`` holds the leaderboard's results.

    A recording without a scored run has no page.
    """
    jobs = list(_plan_pages(out, board))
    missing = [job for job in jobs if _read_key(job.target) != job.key]
    outcomes = run_jobs(_write_page, missing, "pages of runs") if missing else []
    errors = {job.source.recording: outcome.error for job, outcome in zip(missing, outcomes, strict=True)}
    return RunPages(
        {
            job.source.recording: f"{_FOLDER}/{quote(job.target.name)}"
            for job in jobs
            if _read_key(job.target) == job.key
        },
        {name: error for name, error in errors.items() if error},
    )


def _plan_pages(out: Path, board: Leaderboard) -> Iterator[_PageJob]:
    """Yield one job per recording that has a score."""
    store = ResultStore(out / RESULTS)
    for source in board.sources:
        runs = [run for run in board.runs if run.recording == source.recording and run.score_key and run.estimate_key]
        if not runs:
            continue
        judges = dict.fromkeys((run.against, run.judge_file) for run in runs)
        judged = tuple(
            _Judged(
                _find_judge(source, against, file, board),
                tuple(run for run in runs if (run.against, run.judge_file) == (against, file)),
            )
            for against, file in judges
        )
        reference = _find_reference(out, source, judged)
        key = make_key(
            what="page of a recording",
            judges=[one.judge.key for one in judged],
            runs=[(run.label, run.estimate_key, run.score_key) for run in runs],
            align=board.align,
            reference=None if reference is None else sha256(reference),
            page=_hash_templates(),
        )
        yield _PageJob(source, judged, reference, board.align, out / _FOLDER / f"{source.recording}.html", key, store)


def _find_judge(source: Source, against: str, file: str | None, board: Leaderboard) -> JudgeSpec:
    """Return the judge of a run as it was when the run was scored."""
    if against == TRUTH or file is None:
        return judge_by_truth(source)
    return JudgeSpec(against, sha256(Path(file)), Path(file), at_truth=board.against == "both" and source.truth)


def _find_reference(out: Path, source: Source, judged: Sequence[_Judged]) -> Path | None:
    """Return the reference that judged, else the one beside the recording or made for the calibration."""
    for one in judged:
        if one.judge.file is not None:
            return one.judge.file
    name = f"{source.recording}.reference.mcap"
    return next(
        (file for file in (Path(source.file).with_name(name), out / "references" / name) if file.is_file()), None
    )


@cache
def _hash_templates() -> str:
    """Return a hash of the templates and the script, so that pages of an earlier look are made again."""
    digest = hashlib.sha256()
    for file in sorted(resources.files(PARTS).iterdir(), key=lambda file: file.name):
        if file.name.endswith((".j2", ".js")):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _read_key(page: Path) -> str | None:
    """Return the key that a page carries; None where there is no such page."""
    try:
        with page.open("rb") as file:
            found = _KEY.search(file.read(_HEAD_BYTES))
    except OSError:
        return None
    return None if found is None else found[1].decode()


def _write_page(job: _PageJob) -> None:
    """Score the kept estimates as the leaderboard did, and write the page."""
    source = job.source
    recording = read_recording(source.file)
    reference = _read_reference(job)
    estimates: dict[str, Estimate] = {}
    verdicts = []
    for one in job.judged:
        for run in one.runs:
            if run.label not in estimates:
                result = job.store.get(run.estimate_key or "")
                if result is None:
                    raise BadRecording(f"{run.label} on {source.recording}: its estimate is missing; run again")
                estimates[run.label] = load_estimate(result, recording, run.label)
        judge = load_judge(one.judge, recording).trajectory
        common = find_common_samples([run.estimate_key or "" for run in one.runs], one.judge, job.store)
        comparisons = tuple(compare(estimates[run.label], judge, job.align, common) for run in one.runs)
        verdicts.append(Verdict(judge, comparisons, tuple(score_of(each) for each in comparisons)))
    material = Material(
        name=source.recording,
        recording=recording,
        references=() if reference is None else (reference,),
        estimates=tuple(estimates.values()),
        sha256={Path(source.file).name: source.sha256},
    )
    html = make_report_html(material, tuple(verdicts), home=_HOME)
    job.target.parent.mkdir(parents=True, exist_ok=True)
    with write_atomically(job.target) as file:
        file.write(html.replace("<head>", f'<head>\n<meta name="made-from" content="{job.key}">', 1).encode())


def _read_reference(job: _PageJob) -> Reference | None:
    """Return the reference for bias and field; None where there is none of this recording."""
    if job.reference is None:
        return None
    try:
        found = read_reference(job.reference)
    except StillpointError:
        return None
    made_from_it = not found.made_from or job.source.sha256 in found.made_from.values()
    return replace(found, name=job.source.recording) if made_from_it else None
