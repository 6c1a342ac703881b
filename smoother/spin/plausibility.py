"""Judge the optimum of a spinning body's graph: does it hide a spin that rests or turns back?

A rate that is mirrored at zero contradicts the angular acceleration while it turns back, which the robust weights treat
as glitches; a rest is explained by biases and arms that no calibration allows.
"""

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import Unobservable
from stillpoint.smoother.spin.chain import Chain
from stillpoint.smoother.spin.factors import Prior
from stillpoint.smoother.spin.rows import compute_roots
from stillpoint.smoother.spin.solve import SpinSolution
from stillpoint.smoother.spin.state import AMPLITUDE, CONSTANTS

GLITCH = 0.25  # of the weight of a sample without error: below, a sample counts as a glitch
_RUN = 8  # glitches in a row are more than that
_APART = 3  # samples between glitches of one run
_BIASED_SD = 5.0  # of the prior: as far as a bias or an arm may be off
_SCATTER = 5.0  # times what the samples show by themselves
_OR_ELSE = "the spin rests, turns back or is too slow for its square"


def require_agreement(chain: Chain, solution: SpinSolution, prior: Prior, least_radps: float, name: str) -> None:
    """Raise :class:`Unobservable` where the channels contradict each other or the calibration.

    ``least_radps`` is the change of the rate that a run of glitches may leave unexplained.
    """
    if chain.readings is not None:  # the encoder decides
        return
    at, sizes, n = solution.at, solution.sizes, len(chain.samples)
    off = np.abs(at.state.constants - prior.mean)[:, :AMPLITUDE] / np.sqrt(np.diag(prior.cov))[:AMPLITUDE]
    most = int(off.max(axis=0).argmax())
    if off.max() > _BIASED_SD:
        raise Unobservable(
            f"{name}: the optimum has {CONSTANTS[most]} {off.max():.0f} sd from what `calibration` expects: {_OR_ELSE}"
            ", or the calibration is worse than said; cut it to a fast spin (stillpoint cut), or widen the calibration"
        )
    ratio = sizes.accel_radps2 / chain.samples.accel_sd
    if ratio > _SCATTER:
        raise Unobservable(
            f"{name}: around the optimum the angular acceleration scatters {ratio:.0f} times as much as by itself: "
            f"{_OR_ELSE}; cut it to a fast spin (stillpoint cut), and check lever arms, signs and axes of the geometry"
        )
    weight = compute_roots(chain, at, sizes).accel * sizes.accel_radps2
    glitch = ((weight < GLITCH) & chain.accel_seen).ravel()[:n]
    missing = (chain.span_s * at.accel_residual).ravel()[:n]
    for first, last in _find_runs(glitch):
        change = abs(float(missing[first : last + 1][glitch[first : last + 1]].sum()))
        if glitch[first : last + 1].sum() >= _RUN and change > least_radps:
            t_s = (chain.samples.t_ns[[first, last]] - chain.samples.t_ns[0]) / 1e9
            raise Unobservable(
                f"{name}: between {t_s[0]:.2f} and {t_s[1]:.2f} s the angular acceleration and the squared rate differ "
                f"by {np.rad2deg(change):.0f} deg/s: {_OR_ELSE}, or F5 is disturbed; cut it there (stillpoint cut)"
            )


def _find_runs(wanted: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last of each run of wanted samples; samples up to APART apart belong to one run."""
    rows = np.flatnonzero(wanted)
    if not len(rows):
        return []
    breaks = np.flatnonzero(np.diff(rows) > _APART)
    return list(zip(rows[np.r_[0, breaks + 1]].tolist(), rows[np.r_[breaks, len(rows) - 1]].tolist(), strict=True))
