"""The errors of a run over time, as they are kept for drawing."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.files.result_store import ResultStore
from stillpoint.datasets.recording import Times
from stillpoint.scoring.report.curves import Curve
from stillpoint.studies.leaderboard.board import Run

RESULTS = "results"  # folder of the store in the output folder
_CURVE, _GRID = "curve ", "curve_grid_s"  # names of arrays in the store


@dataclass(frozen=True, eq=False)
class ErrorOverTime:
    """Curves of the errors over all samples with an estimate, moving or not; their times count from ``zero_ns``.

    They are named total, heading and inclination; three standard deviations of the judge are ``total:sd`` and so on.
    """

    zero_ns: int  # on the judge's clock
    rests_ns: Times  # (R, 2) spans that are not scored
    curves: Mapping[str, Curve]


def pack_curves(curves: Mapping[str, Curve]) -> dict[str, NDArray[Any]]:
    """Return the arrays that keep curves over one grid of time in the store."""
    first = next(iter(curves.values()))
    packed = {
        _CURVE + name: np.stack([curve.least, curve.greatest, curve.middle]).astype(np.float32)
        for name, curve in curves.items()
    }
    return {_GRID: np.array([first.start_s, first.step_s]), **packed}


def read_error_series(out: Path, run: Run) -> ErrorOverTime | None:
    """Return the errors of a run over time from the output folder of its leaderboard; None for a run that failed."""
    result = None if run.score_key is None else ResultStore(out / RESULTS).get(run.score_key)
    if result is None or _GRID not in result.arrays:
        return None
    start_s, step_s = map(float, result.arrays[_GRID])
    curves = {
        name.removeprefix(_CURVE): Curve(start_s, step_s, *values.astype(np.float64))
        for name, values in result.arrays.items()
        if name.startswith(_CURVE)
    }
    return ErrorOverTime(int(result.arrays["zero_ns"]), result.arrays["rests_ns"], curves)
