"""Score the positions of a reference against a truth that has positions."""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from stillpoint.datasets.recording import Floats, Truth
from stillpoint.datasets.times import find_longest_step_ns
from stillpoint.datasets.trajectory import Estimate, Reference

_CHI2_3_95 = float(chdtri(3, 0.05))


@dataclass(frozen=True)
class PositionScore:
    """Errors of position over the moving samples of the truth, in m.

    The origins of both differ by an unknown constant, so that the mean difference is removed. Nothing is rotated: the
    satellites give true north.
    """

    samples: int
    rmse_m: float
    horizontal_rmse_m: float
    max_m: float
    coverage95: float  # share whose d' C^-1 d is below the 95 % point of chi-square(3)


def score_position(estimated: Estimate | Reference, truth: Reference | Truth) -> PositionScore | None:
    """Return the errors of position, None where one of both has no positions or nothing can be compared.

    Compared at the stamps of the truth, never across a gap of the reference.
    """
    if not isinstance(estimated, Reference) or estimated.position_n_m is None or estimated.position_cov_n_m2 is None:
        return None
    if not isinstance(truth, Truth) or truth.position_n_m is None:
        return None
    use = truth.moving & np.isfinite(truth.position_n_m).all(axis=1)
    use &= (truth.t_ns >= estimated.t_ns[0]) & (truth.t_ns <= estimated.t_ns[-1])
    after = np.clip(np.searchsorted(estimated.t_ns, truth.t_ns), 1, len(estimated.t_ns) - 1)
    use &= np.diff(estimated.t_ns)[after - 1] <= find_longest_step_ns(estimated.t_ns)
    if not use.any():
        return None
    t_ns, after = truth.t_ns[use], after[use]
    found = np.stack([np.interp(t_ns, estimated.t_ns, axis) for axis in estimated.position_n_m.T], axis=1)
    error = found - truth.position_n_m[use]
    error = error - error.mean(axis=0)
    cov: Floats = estimated.position_cov_n_m2[after]
    square = np.einsum("ni,ni->n", error, np.linalg.solve(cov, error[:, :, None])[:, :, 0])
    return PositionScore(
        samples=int(use.sum()),
        rmse_m=float(np.sqrt(np.mean(np.sum(error**2, axis=1)))),
        horizontal_rmse_m=float(np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1)))),
        max_m=float(np.linalg.norm(error, axis=1).max()),
        coverage95=float((square <= _CHI2_3_95).mean()),
    )
