"""Score all estimates of one recording against one judge, on the samples that every estimate covers."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadRecording, StillpointError
from stillpoint.datasets.files.result_store import Result, ResultStore, make_key
from stillpoint.datasets.mcap.store import read_recording
from stillpoint.datasets.recording import Floats, Recording
from stillpoint.datasets.trajectory import Estimate, Reference
from stillpoint.scoring import AlignKind, Comparison, compare, score_of
from stillpoint.scoring.errors import compute_rotation_error_n
from stillpoint.scoring.match import Mask, match, track
from stillpoint.scoring.report.plot_data import find_spans, reduce_errors
from stillpoint.studies.leaderboard.board import Source
from stillpoint.studies.leaderboard.estimates import load_estimate
from stillpoint.studies.leaderboard.judges import Judge, JudgeSpec, compute_covariance_n_deg2, load_judge
from stillpoint.studies.leaderboard.series import pack_curves

_LEAST_COVERED = 0.5  # an estimate of fewer of the judged samples would take them from all others
_MOST_BINS = 2000  # of mean error vectors: one per second up to 33 minutes
_CURVE_COLUMNS = 1000  # of the errors over time, as they are drawn


@dataclass(frozen=True)
class Entry:
    """One estimate that takes part."""

    label: str
    name: str  # of the entrant
    key: str  # of the estimate in the store


@dataclass(frozen=True)
class ScoreJob:
    """All estimates of one recording against one judge."""

    source: Source
    judge: JudgeSpec
    align: AlignKind
    entries: tuple[Entry, ...]
    key: str
    store: ResultStore

    def __str__(self) -> str:
        return f"scores of {self.source.recording} against {self.judge.name}"

    def read_outcomes(self) -> "list[Scored] | None":
        """Return the outcome of each entry; None when the job has not been run."""
        facts = self.store.facts(self.key)
        return None if facts is None else [Scored(*each) for each in facts["scored"]]


@dataclass(frozen=True)
class Scored:
    """The outcome of one entry: the key of its score, or the reason why there is none."""

    label: str
    key: str | None
    error: str | None


def plan_score(
    source: Source, judge: JudgeSpec, align: AlignKind, entries: tuple[Entry, ...], store: ResultStore
) -> ScoreJob:
    """Return the job with the key of its result."""
    judged = {"judge": judge.key, "at_truth": judge.at_truth, "align": align}
    key = make_key(
        what="scores", input=source.sha256, **judged, entries=[(entry.label, entry.key) for entry in entries]
    )
    return ScoreJob(source, judge, align, entries, key, store)


class _Material:
    """The inputs of a job, loaded when it is first asked for: nothing is read when every result is kept already."""

    def __init__(self, job: ScoreJob) -> None:
        self.job = job

    @cached_property
    def recording(self) -> Recording:
        return read_recording(self.job.source.file)

    @cached_property
    def judge(self) -> Judge:
        key = self.job.judge.estimate_key
        return load_judge(self.job.judge, self.recording, None if key is None else self.estimate(key, "judge"))

    def estimate(self, key: str, name: str) -> Estimate:
        """Return an estimate that was kept; raises :class:`BadRecording` where there is none."""
        result = self.job.store.get(key)
        if result is None or result.facts["error"] is not None:
            raise BadRecording(f"{name}: there is no estimate of {self.job.source.recording}")
        return load_estimate(result, self.recording, name)


def score_recording(job: ScoreJob) -> None:
    """Score every entry and keep the scores.

    The samples are those that all entries cover; an entry that covers less than half of them all is left out.
    """
    scored = _score_entries(job)
    job.store.put(job.key, {"scored": [[one.label, one.key, one.error] for one in scored]})


def _score_entries(job: ScoreJob) -> list[Scored]:
    """Score all estimators of a recording over the samples that all of them cover."""
    material = _Material(job)
    masks: dict[str, Mask] = {}
    errors: dict[str, str] = {}
    for entry in job.entries:
        try:
            masks[entry.label] = _find_coverage(job, entry, material)
        except StillpointError as error:
            errors[entry.label] = str(error)
    whole = _unite(list(masks.values()))
    for label, mask in list(masks.items()):
        share = float(mask.sum()) / max(int(whole.sum()), 1)
        if share < _LEAST_COVERED:
            errors[label] = f"covers {share:.0%} of the samples that others cover; with less than half it is left out"
            del masks[label]
    if not masks:
        return [Scored(entry.label, None, errors[entry.label]) for entry in job.entries]
    common = np.logical_and.reduce(list(masks.values()))
    _keep_judge(job, common, material)
    found = []
    for entry in job.entries:
        key = None
        if entry.label in masks:
            try:
                key = _score_entry(job, entry, common, material)
            except StillpointError as error:
                errors[entry.label] = str(error)
        found.append(Scored(entry.label, key, errors.get(entry.label)))
    return found


def judge_key(judge: JudgeSpec, score_facts: Mapping[str, Any]) -> str:
    """Return the key of the judge's covariance over the samples of a score."""
    return make_key(what="judge", judge=judge.key, at_truth=judge.at_truth, samples=score_facts["samples_hash"])


def _find_coverage(job: ScoreJob, entry: Entry, material: _Material) -> Mask:
    """Return which samples (N,) of the judge move and are covered by an estimate."""
    key = _make_coverage_key(entry.key, job.judge)
    kept = job.store.get(key)
    if kept is None:
        estimate = material.estimate(entry.key, entry.name)
        judge = material.judge
        covered = match(track(estimate), judge.trajectory.t_ns).found & judge.moving
        job.store.put(key, {"n": len(covered)}, {"bits": np.packbits(covered)})
        return covered
    return _unpack_mask(kept)


def find_common_samples(estimate_keys: Sequence[str], judge: JudgeSpec, store: ResultStore) -> Mask:
    """Return which samples (N,) of a judge were scored, from what was kept when these estimates were scored together.

    Raises :class:`BadRecording` when it is not there any more.
    """
    kept = [store.get(_make_coverage_key(key, judge)) for key in estimate_keys]
    masks = [_unpack_mask(one) for one in kept if one is not None]
    if len(masks) < len(kept):
        raise BadRecording(f"the samples that {judge.name} scored are missing in {store.folder}; run again")
    return np.logical_and.reduce(masks)


def _make_coverage_key(estimate_key: str, judge: JudgeSpec) -> str:
    return make_key(what="coverage", estimate=estimate_key, judge=judge.key, at_truth=judge.at_truth)


def _unpack_mask(kept: Result) -> Mask:
    return np.unpackbits(kept.arrays["bits"], count=kept.facts["n"]).astype(np.bool_)


def _unite(masks: list[Mask]) -> Mask:
    """Return which samples (N,) any of the masks covers."""
    return np.logical_or.reduce(masks) if masks else np.zeros(0, dtype=np.bool_)


def _score_entry(job: ScoreJob, entry: Entry, common: Mask, material: _Material) -> str:
    """Score one estimate on the common samples, keep it, and return its key."""
    samples_hash = hashlib.sha256(np.packbits(common).tobytes()).hexdigest()
    key = make_key(
        what="score",
        estimate=entry.key,
        judge=job.judge.key,
        at_truth=job.judge.at_truth,
        align=job.align,
        samples=samples_hash,
    )
    if job.store.facts(key) is None:
        estimate = material.estimate(entry.key, entry.name)
        comparison = compare(estimate, material.judge.trajectory, job.align, common)
        facts = _list_figures(comparison) | {"samples_hash": samples_hash}
        job.store.put(key, facts, _make_error_arrays(comparison))
    return key


def _list_figures(comparison: Comparison) -> dict[str, Any]:
    """Return the figures of a run under the names of :class:`Run`."""
    score = score_of(comparison)
    alignment = comparison.alignment
    return {
        "total_rmse_deg": score.total_rmse_deg,
        "heading_rmse_deg": score.heading_rmse_deg,
        "inclination_rmse_deg": score.inclination_rmse_deg,
        "total_p95_deg": score.total_p95_deg,
        "total_max_deg": score.total_max_deg,
        "samples": score.samples,
        "nees_per_dof": score.nees_per_dof,
        "coverage95": score.coverage95,
        "reference_sd_deg": score.reference_sd_deg,
        "aligned_heading_deg": float(np.rad2deg(alignment.heading_rad)),
        "aligned_mounting_deg": float(np.rad2deg(np.linalg.norm(alignment.mounting_rotvec_rad))),
        "aligned_time_s": float(alignment.time_offset_s),
    }


def _make_error_arrays(comparison: Comparison) -> dict[str, NDArray[Any]]:
    """Return the mean error vectors per bin of time, and what is drawn of the errors over time."""
    moving, zero_ns = comparison.moving, int(comparison.t_ns[0])
    vectors = np.rad2deg(compute_rotation_error_n(comparison.q_est[moving], comparison.q_true[moving]))
    bins, means = _average_per_bin(comparison.t_ns[moving], vectors)
    drawn = pack_curves(reduce_errors(comparison, zero_ns, _CURVE_COLUMNS))
    rests_ns = find_spans(~moving, comparison.t_ns)
    return {
        "bins": bins,
        "error_n_deg": means.astype(np.float32),
        "zero_ns": np.array(zero_ns),
        "rests_ns": rests_ns,
        **drawn,
    }


def _keep_judge(job: ScoreJob, common: Mask, material: _Material) -> None:
    """Keep the covariance of a reference per bin of time, for the effect of its error on ratios."""
    if job.judge.file is None:
        return
    samples_hash = hashlib.sha256(np.packbits(common).tobytes()).hexdigest()
    key = judge_key(job.judge, {"samples_hash": samples_hash})
    if job.store.facts(key) is not None:
        return
    reference = material.judge.trajectory
    assert isinstance(reference, Reference)
    bins, means = _average_per_bin(reference.t_ns[common], compute_covariance_n_deg2(reference)[common].reshape(-1, 9))
    job.store.put(key, {}, {"bins": bins, "cov_n_deg2": means.reshape(-1, 3, 3)})


def _average_per_bin(t_ns: NDArray[np.int64], values: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return the bins of time that hold samples, in ns, and the mean of the values (N, k) in each."""
    width_ns = max(1_000_000_000, -(-int(t_ns[-1] - t_ns[0] + 1) // _MOST_BINS))
    number = t_ns // width_ns
    first = np.flatnonzero(np.diff(number, prepend=number[0] - 1))
    counts = np.diff(first, append=len(t_ns))
    means = np.add.reduceat(values, first, axis=0) / counts[:, None]
    return number[first] * width_ns, np.asarray(means, dtype=np.float64)
