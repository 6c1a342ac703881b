"""Find the optimum of a spinning body's graph: Gauss-Newton with robust weights and a line search."""

from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.errors import Unobservable
from stillpoint.smoother.spin.chain import Chain
from stillpoint.smoother.spin.factors import Prior, eliminate, prior_cost, solve_step
from stillpoint.smoother.spin.params import SpinGraphParams
from stillpoint.smoother.spin.rows import Sizes, SpinFit, compute_roots, cost, estimate_sizes, fit
from stillpoint.smoother.spin.state import SpinState

_ADAPTING = 6  # iterations, after which the noise is kept: noise and weights could oscillate
_HALVINGS = 8  # of a step that makes the fit worse


@dataclass(frozen=True, eq=False)
class SpinSolution:
    """The optimum, and how it was found."""

    at: SpinFit
    sizes: Sizes  # of the noise
    steps_radps: tuple[float, ...]  # the change of the rates, RMS, per iteration


def improve(
    chain: Chain, state: SpinState, prior: Prior, name: str, params: SpinGraphParams, iterations: int
) -> SpinSolution:
    """Return the state after Gauss-Newton iterations, until the change is small or for ``iterations``.

    Each iteration renews the robust weights and searches along its step. Unless the noise of a channel is given, it is
    the larger of the samples' own noise and the residuals'. Raises :class:`Unobservable` when the system is singular.
    """
    steps: list[float] = []
    at = fit(chain, state)
    sizes = estimate_sizes(chain, at, params.noise)
    while len(steps) < iterations and not (steps and steps[-1] < params.rate_limit_radps):
        if len(steps) < _ADAPTING:
            sizes = estimate_sizes(chain, at, params.noise)
        roots = compute_roots(chain, at, sizes)
        step = solve_step(chain, eliminate(chain, at, roots, prior, name), len(state.constants))
        before, share = cost(at, roots) + prior_cost(chain, at.state, prior), 1.0
        for _ in range(_HALVINGS):
            after = fit(chain, _add_step(at.state, step, share))
            if cost(after, roots) + prior_cost(chain, after.state, prior) <= before * (1 + 1e-9):
                break
            share /= 2
        at = after
        steps.append(share * float(np.sqrt(np.mean(step.mean_rate_radps**2))))
    return SpinSolution(at, sizes, tuple(steps))


def make_no_optimum(name: str, solution: SpinSolution) -> Unobservable:
    """Return the error of a solution that did not converge."""
    count, last_degps = len(solution.steps_radps), np.rad2deg(solution.steps_radps[-1])
    return Unobservable(
        f"{name}: no optimum in {count} iterations, the last changed the rate by {last_degps:.2g} deg/s; "
        "the accelerometers contradict each other: check units, lever arms, signs and axes of the geometry, and that "
        "the body neither rests nor turns back"
    )


def _add_step(state: SpinState, step: SpinState, share: float) -> SpinState:
    return SpinState(
        state.start_angle_rad + share * step.start_angle_rad,
        state.mean_rate_radps + share * step.mean_rate_radps,
        state.constants + share * step.constants,
    )
