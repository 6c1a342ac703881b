"""The judges of a recording's estimates: independent truth, a reference, or an offline estimator.

Where a recording has truth and several judges are compared, every judge is read at the truth's stamps, so that all
score the same samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillpoint.datasets.errors import BadRecording
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.mcap.store import read_reference
from stillpoint.datasets.recording import Floats, Recording, Truth
from stillpoint.datasets.trajectory import Estimate, Reference
from stillpoint.scoring.compare import find_moving
from stillpoint.scoring.match import Mask, interpolate_attitude, interpolate_covariance, match, require_some, track
from stillpoint.studies.leaderboard.board import Source
from stillpoint.studies.leaderboard.references import References
from stillpoint.studies.leaderboard.study import REFERENCE

TRUTH = "truth"


@dataclass(frozen=True)
class JudgeSpec:
    """Where a judge is kept; it can be pickled and is cheap to make."""

    name: str  # "truth", "reference (METHOD)" or the name of an offline estimator
    key: str  # of its content
    file: Path | None = None  # of a reference
    estimate_key: str | None = None  # in the store, of an offline estimator
    at_truth: bool = False  # read it at the stamps of the recording's truth


@dataclass(frozen=True, eq=False)
class Judge:
    """A judge with the samples that it can score."""

    trajectory: Reference | Truth
    moving: Mask  # (N,)


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


def load_judge(spec: JudgeSpec, recording: Recording, estimate: Estimate | None = None) -> Judge:
    """Load the judge of a recording; raises :class:`BadRecording` when it has no truth to judge by."""
    judge: Reference | Truth | Estimate
    if spec.name == TRUTH:
        judge = _require_truth(recording)
    elif spec.file is not None:
        judge = read_reference(spec.file)
    else:
        assert estimate is not None
        judge = estimate
    if isinstance(judge, Estimate) or (spec.at_truth and isinstance(judge, Reference)):
        return _read_at_truth(judge, _require_truth(recording))
    return Judge(judge, find_moving(judge))


def compute_covariance_n_deg2(reference: Reference) -> Floats:
    """Return the covariance (N, 3, 3) of a reference in East-North-Up, in deg²."""
    rot = rotation(reference.q_nb).as_matrix()
    turned = rot @ reference.cov_b_rad2 @ rot.transpose(0, 2, 1)
    return np.asarray(turned * np.rad2deg(1.0) ** 2, dtype=np.float64)


def _require_truth(recording: Recording) -> Truth:
    if recording.truth is None:
        raise BadRecording(f"{recording.name}: has no independent truth; use --against reference")
    return recording.truth


def _read_at_truth(judge: Reference | Estimate, truth: Truth) -> Judge:
    """Read a judge at the truth's stamps; samples that it does not cover are left out."""
    source = track(judge)
    found = require_some(source, match(source, truth.t_ns))
    t_ns = truth.t_ns[found]
    q_nb = interpolate_attitude(source, t_ns)
    moving = truth.moving[found]
    if isinstance(judge, Estimate):
        return Judge(Truth(t_ns, q_nb, moving), moving)
    cov = interpolate_covariance(source, t_ns)
    assert cov is not None
    at_truth = Reference(
        t_ns=t_ns,
        q_nb=q_nb,
        cov_b_rad2=cov,
        gyro_bias_b_radps=np.zeros((len(t_ns), 3)),
        method=judge.method,
        name=judge.name,
        heading_sd_rad=judge.heading_sd_rad,
        mounting_cov_b_rad2=judge.mounting_cov_b_rad2,
    )
    return Judge(at_truth, moving)
