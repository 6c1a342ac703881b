"""Errors of turns over a given time: how fast an estimate drifts, independent of its first heading.

What other tools call the relative pose error (evo_rpe --all_pairs -r angle_deg), of the rotation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.errors import BadParameter, Unobservable
from stillpoint.datasets.frames import compose, quaternion, rotation
from stillpoint.scoring.compare import Comparison
from stillpoint.scoring.errors import compute_attitude_error


@dataclass(frozen=True)
class TurnError:
    """Errors of all turns from one scored sample to another ``over_s`` later."""

    over_s: float
    turns: int  # that were compared
    rmse_deg: float
    p95_deg: float
    max_deg: float


def turn_errors(comparison: Comparison, over_s: Sequence[float]) -> tuple[TurnError, ...]:
    """Return the errors of the turns over each time in seconds. Both ends are moving samples; it may rest in between.

    Raises :class:`BadParameter` for a time that is not longer than half a step, or not finite, :class:`Unobservable`
    where no two samples are so far apart.
    """
    return tuple(_compute_turn_error(comparison, seconds) for seconds in over_s)


def _compute_turn_error(comparison: Comparison, seconds: float) -> TurnError:
    """Return the error of turns over this time; raises :class:`Unobservable` where no two samples are so far apart."""
    if not (np.isfinite(seconds) and seconds > 0):
        raise BadParameter(f"over: {seconds:g} s is not a length of time; give seconds above 0")
    whose = f"{comparison.estimated} of {comparison.recording}"
    t_ns = comparison.t_ns[comparison.moving]
    if 1e9 * seconds > t_ns[-1] - t_ns[0]:
        raise Unobservable(f"{whose}: no two scored samples are {seconds:g} s apart; give a shorter time")
    step_ns = float(np.median(np.diff(comparison.t_ns)))
    if 1e9 * seconds < step_ns:
        raise BadParameter(f"over: {seconds:g} s is less than a step of {step_ns / 1e9:.3g} s; give a longer time")
    wanted_ns = t_ns + round(1e9 * seconds)
    after = np.clip(np.searchsorted(t_ns, wanted_ns), 1, max(len(t_ns) - 1, 1))
    end = after - (wanted_ns - t_ns[after - 1] < t_ns[after] - wanted_ns) if len(t_ns) > 1 else after - 1
    start = np.flatnonzero((np.abs(t_ns[end] - wanted_ns) <= step_ns / 2) & (end > np.arange(len(t_ns))))
    if not len(start):
        raise Unobservable(f"{whose}: no two scored samples are {seconds:g} s apart; give another time")
    turned = [
        compose(rotation(q[comparison.moving][start]).inv(), rotation(q[comparison.moving][end[start]]))
        for q in (comparison.q_est, comparison.q_true)
    ]
    error_deg = np.rad2deg(compute_attitude_error(quaternion(turned[0]), quaternion(turned[1])).total_rad)
    return TurnError(
        over_s=seconds,
        turns=len(start),
        rmse_deg=float(np.sqrt(np.mean(error_deg**2))),
        p95_deg=float(np.percentile(error_deg, 95)),
        max_deg=float(error_deg.max()),
    )
