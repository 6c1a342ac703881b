"""The optimum of a spinning body's graph: Gauss-Newton with robust weights and a line search."""

from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.errors import Unobservable
from stillpoint.smoother.spin.chain import Chain
from stillpoint.smoother.spin.factors import Prior, eliminated, prior_cost, step_of
from stillpoint.smoother.spin.params import RollGraphParams
from stillpoint.smoother.spin.rows import RollFit, Sizes, cost, fit, roots_of, sizes_of
from stillpoint.smoother.spin.state import RollState

ADAPTING = 6  # iterations, after which the noise is no longer fitted: it and the weights could chase each other
HALVINGS = 8  # of a step that makes the fit worse


@dataclass(frozen=True, eq=False)
class RollSolution:
    """The optimum, and how it was found."""

    at: RollFit
    sizes: Sizes  # of the noise
    steps_radps: tuple[float, ...]  # the change of the rates, RMS, per iteration


def improved(
    chain: Chain, state: RollState, prior: Prior, name: str, params: RollGraphParams, iterations: int
) -> RollSolution:
    """Gauss-Newton with a line search, the robust weights renewed in every iteration, until the limit or for so many.

    The noise of a channel is the larger of what the samples show and of what the fit leaves, unless it is given.
    Raises :class:`Unobservable`.
    """
    steps: list[float] = []
    at = fit(chain, state)
    sizes = sizes_of(chain, at, params.noise)
    while len(steps) < iterations and not (steps and steps[-1] < params.rate_limit_radps):
        if len(steps) < ADAPTING:
            sizes = sizes_of(chain, at, params.noise)
        roots = roots_of(chain, at, sizes)
        step = step_of(chain, eliminated(chain, at, roots, prior, name), len(state.constants))
        before, share = cost(at, roots) + prior_cost(chain, at.state, prior), 1.0
        for _ in range(HALVINGS):
            after = fit(chain, _plus(at.state, step, share))
            if cost(after, roots) + prior_cost(chain, after.state, prior) <= before * (1 + 1e-9):
                break
            share /= 2
        at = after
        steps.append(share * float(np.sqrt(np.mean(step.mean_rate_radps**2))))
    return RollSolution(at, sizes, tuple(steps))


def no_optimum(name: str, solution: RollSolution) -> Unobservable:
    """The error of a solution that has not come to rest."""
    count, last_degps = len(solution.steps_radps), np.rad2deg(solution.steps_radps[-1])
    return Unobservable(
        f"{name}: no optimum in {count} iterations, the last changed the rate by {last_degps:.2g} deg/s; "
        "the accelerometers contradict each other: check units, lever arms, signs and axes of the geometry, and that "
        "the body neither rests nor turns back"
    )


def _plus(state: RollState, step: RollState, share: float) -> RollState:
    return RollState(
        state.start_angle_rad + share * step.start_angle_rad,
        state.mean_rate_radps + share * step.mean_rate_radps,
        state.constants + share * step.constants,
    )
