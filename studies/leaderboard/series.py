"""The error of a run over time, as it is kept for drawing."""

from dataclasses import dataclass
from pathlib import Path

from stillpoint.datasets.recording import Floats
from stillpoint.studies.leaderboard.board import Run
from stillpoint.studies.result_store import ResultStore

RESULTS = "results"  # folder of the store in the output folder


@dataclass(frozen=True, eq=False)
class ErrorOverTime:
    """Least and greatest error in B stretches of time, over all samples with an estimate, moving or not.

    Drawn as a band, no peak is lost. The columns are total, heading and inclination.
    """

    t_s: Floats  # (B,) at which each stretch begins, from zero_ns on
    zero_ns: int  # on the judge's clock
    least_deg: Floats  # (B, 3)
    greatest_deg: Floats  # (B, 3)


def read_error_series(out: Path, run: Run) -> ErrorOverTime | None:
    """Return the error of a run over time from the output folder of its leaderboard; None for a run that failed."""
    result = None if run.score_key is None else ResultStore(out / RESULTS).get(run.score_key)
    if result is None:
        return None
    arrays = result.arrays
    return ErrorOverTime(
        t_s=arrays["envelope_t_s"],
        zero_ns=int(arrays["zero_ns"][0]),
        least_deg=arrays["envelope_least_deg"].astype(float),
        greatest_deg=arrays["envelope_greatest_deg"].astype(float),
    )
