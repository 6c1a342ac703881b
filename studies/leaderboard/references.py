"""The references of a leaderboard: those beside the recordings, and those that it makes itself."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stillpoint.datasets import write
from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.datasets.files.result_store import ResultStore, make_key
from stillpoint.datasets.mcap.store import read_provenance, read_recording, sha256
from stillpoint.smoother import DEFAULT_METHOD, attitude_reference
from stillpoint.studies.job_runner import JobRunner
from stillpoint.studies.leaderboard.board import Source


@dataclass(frozen=True)
class KeptReference:
    """The reference of a recording, or the reason why there is none."""

    file: Path | None = None
    method: str = DEFAULT_METHOD
    sha256: str = ""
    error: str | None = None


References = Mapping[str, KeptReference]  # by recording


@dataclass(frozen=True)
class _ReferenceJob:
    """The reference of one recording by one method."""

    source: Source
    method: str
    target: Path
    key: str
    store: ResultStore

    def __str__(self) -> str:
        return f"reference of {self.source.recording}"


def _plan_reference(source: Source, out: Path, store: ResultStore, method: str = DEFAULT_METHOD) -> _ReferenceJob:
    """Return the job that would make the reference of a recording."""
    middle = "" if method == DEFAULT_METHOD else f".{method}"
    target = out / "references" / f"{source.recording}{middle}.reference.mcap"
    return _ReferenceJob(source, method, target, make_key(what="reference", input=source.sha256, method=method), store)


def _find_reference(job: _ReferenceJob) -> KeptReference | None:
    """Return the reference beside the recording if it was made from it, else the one made before; None: make it."""
    beside = _read_beside(job)
    if beside is not None:
        return beside
    facts = job.store.facts(job.key)
    if facts is None:
        return None
    if facts["error"] is not None:
        return KeptReference(None, job.method, error=facts["error"])
    if not job.target.is_file() or sha256(job.target) != facts["sha256"]:
        return None
    return KeptReference(job.target, job.method, facts["sha256"])


def _make_reference(job: _ReferenceJob) -> None:
    """Make a reference and keep it, or the reason why the recording does not fix one."""
    try:
        made = attitude_reference(read_recording(job.source.file), job.method)
    except BadParameter:
        raise
    except StillpointError as error:
        job.store.put(job.key, {"error": str(error)})
        return
    try:
        job.target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadParameter(f"{job.target.parent}: cannot be made ({error.strerror}); name another folder") from None
    write(job.target, replace(made, made_from={Path(job.source.file).name: job.source.sha256}))
    job.store.put(job.key, {"error": None, "sha256": sha256(job.target)})


def find_references(
    sources: Sequence[Source], out: Path, store: ResultStore, run_jobs: JobRunner, method: str = DEFAULT_METHOD
) -> dict[str, KeptReference]:
    """Return the references of recordings by their names; those that are missing are made."""
    jobs = [_plan_reference(source, out, store, method) for source in sources]
    missing = [job for job in jobs if _find_reference(job) is None]
    outcomes = run_jobs(_make_reference, missing, "references") if missing else []
    errors = {job.source.recording: outcome.error for job, outcome in zip(missing, outcomes, strict=True)}
    return {
        job.source.recording: _find_reference(job)
        or KeptReference(error=errors.get(job.source.recording) or "the reference is missing")
        for job in jobs
    }


def _read_beside(job: _ReferenceJob) -> KeptReference | None:
    """Return ``NAME.reference.mcap`` beside the recording if it is of this method and was made from this recording."""
    file = Path(job.source.file).with_name(f"{job.source.recording}.reference.mcap")
    if not file.is_file():
        return None
    digest = sha256(file)
    key = make_key(what="reference beside", file=digest)
    facts = job.store.facts(key)
    if facts is None:
        try:
            found = read_provenance(file)
        except StillpointError:
            return None
        facts = {"method": found.facts.get("method"), "made_from": list(found.facts.get("made_from", {}).values())}
        job.store.put(key, facts)
    same = facts["method"] == job.method and job.source.sha256 in facts["made_from"]
    return KeptReference(file, job.method, digest) if same else None
