"""Which judge each recording gets: truth where it has one, the reference elsewhere, or what the user asks for."""

from collections.abc import Sequence

from stillpoint.studies.leaderboard.board import Source
from stillpoint.studies.leaderboard.judges import TRUTH, JudgeSpec
from stillpoint.studies.leaderboard.references import References
from stillpoint.studies.leaderboard.study import REFERENCE


def needs_reference(source: Source, against: str, calibrations: Sequence[str]) -> bool:
    """Return whether judging a recording, or its calibration, needs a reference."""
    if source.error is not None:
        return False
    if REFERENCE in calibrations or against in (REFERENCE, "both"):
        return True
    return against == "auto" and not source.truth


def find_judge(source: Source, against: str, at_truth: bool, references: References) -> JudgeSpec | str:
    """Return the judge of a recording, or the reason why there is none.

    ``at_truth`` reads a reference at the stamps of the recording's truth, so that both score the same samples.
    """
    if source.error is not None:
        return source.error
    if against == TRUTH or (against == "auto" and source.truth):
        if not source.truth:
            return f"{source.recording}: has no independent truth; use --against reference"
        return judge_by_truth(source)
    reference = references[source.recording]
    if reference.file is None:
        return f"no reference: {reference.error}"
    return JudgeSpec(
        f"reference ({reference.method})",
        reference.sha256,
        reference.file,
        at_truth=at_truth and source.truth,
    )


def judge_by_truth(source: Source) -> JudgeSpec:
    """Return the independent truth of a recording as its judge."""
    return JudgeSpec(TRUTH, f"truth {source.sha256}")
