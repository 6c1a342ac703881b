"""``stillpoint validate`` for recordings of a spinning body."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from stillpoint.datasets.errors import StillpointError, require_known
from stillpoint.datasets.trajectory import Estimate, SpinReference
from stillpoint.filters import estimate
from stillpoint.filters.table import ROLLS
from stillpoint.scoring.align import AlignKind
from stillpoint.scoring.spin import SpinScore, score_roll, spin_score_row, usual_zero
from stillpoint.scripts.shared.jobs import exit_code, run_jobs
from stillpoint.scripts.shared.output import STDOUT, JsonFile, write_json
from stillpoint.scripts.shared.recordings import open_recording
from stillpoint.scripts.shared.tables import print_refusals
from stillpoint.scripts.verbs.score_spin import find_spin_judge, print_spin_scores, zero_of
from stillpoint.smoother import reference
from stillpoint.smoother.reference import ROLL_METHODS


def validate_spin(
    sources: Sequence[Path], methods: Sequence[str] | None, align: AlignKind, jobs: int | None, json: JsonFile
) -> int:
    """Score angle and rate by each method against the truth, else the encoder, of each recording."""
    zero_of(align, "validate")
    chosen = list(dict.fromkeys(methods or ROLL_METHODS))
    for name in chosen:
        require_known(name, [*ROLL_METHODS, *ROLLS], "roll reference method or estimator")
    work = [(source, name) for source in sources for name in chosen]
    outcomes = run_jobs(partial(_score_source, align=align), work, jobs, "validate")
    refused = [(str(o.error), name) for (_, name), o in zip(work, outcomes, strict=True) if o.value is None]
    rows: list[dict[str, Any]] = [
        {"recording": source.stem, "method": name, "error": outcome.error}
        if outcome.value is None
        else spin_score_row(outcome.value)
        for (source, name), outcome in zip(work, outcomes, strict=True)
    ]
    write_json(json, rows)
    if len(refused) == len(work) == 1:
        raise StillpointError(refused[0][0])
    if json != STDOUT:
        print_spin_scores([outcome.value for outcome in outcomes if outcome.value is not None])
        print_refusals("not scored", refused)
    return exit_code(outcomes)


def _score_source(job: tuple[Path, str], align: AlignKind) -> SpinScore:
    """Score one recording by one method or estimator."""
    source, name = job
    judge = find_spin_judge(source)
    recording = open_recording(source)
    made = reference(recording, name) if name in ROLL_METHODS else estimate(recording, name)
    assert isinstance(made, SpinReference | Estimate)
    zero = zero_of(align, source.name) or usual_zero(made, judge.truth, judge.name)
    return score_roll(made, judge.truth, zero, judge.name)
