"""Factors of a spinning body's graph: angle and rate at every sample, and the unknown constants of its sensors.

    K angle and rate at a key, every few samples        C biases, errors of the lever arms, gravity, vibration,
                                                          the encoder's offset and latency: one every 10 s
          C0 ---------------- C1
        / |  |              |
      K0 ---- K1 ---- K2 ---- K3 ...      each line K-K is one block: its samples of acceleration and squared rate,
      |                                   and the rates inside it, which are eliminate exactly (blocks.py)
      prior of the first angle

The measurement equations (rows.py) are linearised anew in every iteration, with robust weights: Gauss-Newton with a
line search. gtsam eliminates the keys and computes their covariances.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, K
from numpy.typing import NDArray

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Floats
from stillpoint.smoother.connectivity import require_connected
from stillpoint.smoother.spin.blocks import Condensed, compute_variances, condense, solve_inside
from stillpoint.smoother.spin.chain import Chain, integrate_angles
from stillpoint.smoother.spin.once_per_turn import Line
from stillpoint.smoother.spin.params import SpinGraphParams
from stillpoint.smoother.spin.rows import Roots, SpinFit, build_jacobian
from stillpoint.smoother.spin.samples import SpinSamples
from stillpoint.smoother.spin.state import (
    AMPLITUDE,
    ARM_A,
    ARM_S,
    CONSTANTS,
    COS_A,
    COS_S,
    LATENCY,
    OFFSET,
    SIN_A,
    SIN_S,
    SpinState,
    split_blocks,
)

_HELD = 1e-4  # sd of a constant that is not estimated: practically zero, but well conditioned
_ZERO_SD_RAD = 1e-4  # of the first angle if nothing else defines the angle zero
_CONSTANT = 1e-3  # sd of a constant's change from step to step, relative to its sd: practically none
_CHANGING = 0.3  # the same for a vibration
_UNOBSERVABLE_SHARE = 0.9  # of the prior's sd: a constant whose posterior sd is larger is fixed
_FREE_SD_RAD = 10.0  # of an angle that the data must determine


@dataclass(frozen=True, eq=False)
class Prior:
    """The prior knowledge: the angle at the first sample, and the constants around zero."""

    angle_rad: float
    angle_sd_rad: float
    mean: Floats  # (11,)
    cov: Floats  # (11, 11)
    walk_cov: Floats  # (11, 11) from step to step


def make_prior(
    samples: SpinSamples, line: Line | None, encoder: bool, angle_rad: float, params: SpinGraphParams
) -> Prior:
    """Return the prior of angle and constants; constants that no data can determine are fixed at their mean."""
    p = params.calibration
    sizes, steps = np.full((2, len(CONSTANTS)), _HELD)
    mean = np.zeros(len(CONSTANTS))
    free = {ARM_S: p.lever_arm_sd, ARM_A: p.lever_arm_sd}
    gravity = line is not None and line.is_gravity
    if line is not None and line.is_gravity:
        free[AMPLITUDE] = params.harmonic.amplitude_sd_mps2
        mean[AMPLITUDE] = line.gravity_mps2
        # Each channel sees gravity through its own scale and axis, which are as uncertain as the lever arms.
        squared, accel = (np.linalg.norm(k) for k in (samples.squared_gravity, samples.accel_gravity))
        for constant, gravity_sensitivity in ((COS_S, squared), (SIN_S, squared), (COS_A, accel), (SIN_A, accel)):
            free[constant] = max(_HELD, p.lever_arm_sd * line.gravity_mps2 * float(gravity_sensitivity))
    if encoder:
        free[LATENCY] = params.encoder.latency_sd_s
    if encoder and gravity:
        free[OFFSET] = _FREE_SD_RAD
    for constant, sd in free.items():
        sizes[constant], steps[constant] = sd, _CONSTANT * sd
    if line is not None and line.is_vibration:
        shaken = [COS_S, SIN_S, COS_A, SIN_A]
        mean[shaken], sizes[shaken] = _expect_vibration(samples, line, params)
        steps[shaken] = _CHANGING * sizes[shaken]
    cov, walk = np.diag(sizes**2), np.diag(steps**2)
    bias = samples.bias_per_accel @ samples.bias_per_accel.T  # of biases of 1 m/s^2
    cov[:2, :2] = p.accel_bias_sd_mps2**2 * bias
    walk[:2, :2] = p.accel_bias_walk**2 * p.step_s * bias
    return Prior(angle_rad, _FREE_SD_RAD if gravity or encoder else _ZERO_SD_RAD, mean, cov, walk)


def _expect_vibration(samples: SpinSamples, line: Line, params: SpinGraphParams) -> tuple[Floats, Floats]:
    """Return means and sd (4,) of the vibration: cos and sin in the squared rate, then in the acceleration.

    Each accelerometer may be shaken by any amount, so the line does not show the rate. The true ripple is assumed to
    be of the usual size, and the vibration of the squared rate is the line minus such a ripple.
    """
    mean = np.array([line.squared.real, -line.squared.imag, line.accel.real, -line.accel.imag])
    ripple = 2 * line.rate_radps**2 * params.harmonic.ripple
    free = params.harmonic.amplitude_sd_mps2 * float(np.linalg.norm(samples.bias_per_accel[1]))
    return mean, np.array([ripple, ripple, free, free])


def find_unobservable_constants(linear: "Linear", prior: Prior, name: str) -> NDArray[np.bool_]:
    """Return which constants (11,) the samples hardly determine: their sd is still that of the prior.

    A vibration of the squared rate is always among them: what the samples seem to show of it comes from the angle along
    which both vibrations are fitted, which is not exact. Raises :class:`Unobservable` when the system is singular.
    """
    try:
        found = np.sqrt(np.diag(linear.tree.marginalCovariance(C(0))))
    except RuntimeError as error:
        raise _rate_not_fixed(name) from error
    held = found > _UNOBSERVABLE_SHARE * np.sqrt(np.diag(prior.cov))
    held[[COS_S, SIN_S]] = True
    return np.asarray(held)


def fix_constants(prior: Prior, held: NDArray[np.bool_]) -> Prior:
    """Return the prior with some constants held at their means."""

    def hold(cov: Floats) -> Floats:
        small = np.where(held, _CONSTANT, 1.0)
        return np.where(held[:, None] ^ held[None, :], 0.0, cov * np.outer(small, small))

    return replace(prior, cov=hold(prior.cov), walk_cov=hold(prior.walk_cov))


def _prior_factors(chain: Chain, state: SpinState, prior: Prior) -> Iterator[gtsam.JacobianFactor]:
    """Keep the first angle and the constants near their prior means, and let the constants walk from step to step."""
    first = np.array([[1.0, chain.step_s[0]]]) / prior.angle_sd_rad
    off = (prior.angle_rad - integrate_angles(chain, state)[0]) / prior.angle_sd_rad
    yield gtsam.JacobianFactor(K(0), first, np.array([off]), gtsam.noiseModel.Unit.Create(1))
    unit = gtsam.noiseModel.Unit.Create(len(CONSTANTS))
    root = np.linalg.inv(np.linalg.cholesky(prior.cov))
    yield gtsam.JacobianFactor(C(0), root, root @ (prior.mean - state.constants[0]), unit)
    root = np.linalg.inv(np.linalg.cholesky(prior.walk_cov))
    for s, change in enumerate(np.diff(state.constants, axis=0)):
        yield gtsam.JacobianFactor(C(s), -root, C(s + 1), root, -root @ change, unit)


def prior_cost(chain: Chain, state: SpinState, prior: Prior) -> float:
    """Return the sum of squares of the prior at a state."""
    return float(sum(np.sum(factor.getb() ** 2) for factor in _prior_factors(chain, state, prior)))


def _block_factors(chain: Chain, blocks: Condensed) -> Iterator[gtsam.JacobianFactor]:
    """Tie the two keys of each block and the constants by the samples of the block."""
    unit = gtsam.noiseModel.Unit.Create(blocks.outer.shape[1])
    for i, (a, b) in enumerate(zip(blocks.outer, blocks.outer_right, strict=True)):
        c = C(int(chain.constants_of[i]))
        yield gtsam.JacobianFactor(K(i), a[:, :2], K(i + 1), a[:, 2:4], c, a[:, 4:], b, unit)


def require_connected_chain(chain: Chain, steps: int, name: str) -> None:
    """Raise :class:`Unobservable` where a block or a step of the constants hangs on nothing; see connectivity.py."""
    links = [[K(i), K(i + 1), C(int(c))] for i, c in enumerate(chain.constants_of)]
    links += [[C(s), C(s + 1)] for s in range(steps - 1)]
    wanted = [key for block in links[: chain.blocks] for key in block]
    keys = np.array([key for link in links for key in link], dtype=np.int64)
    lengths = np.array([len(link) for link in links])
    require_connected(keys, lengths, wanted, lambda key: f"the {gtsam.Symbol(key).string()} of the spin", name)


@dataclass(frozen=True, eq=False)
class Linear:
    """The graph, linearised at a state and eliminated."""

    blocks: Condensed
    tree: gtsam.GaussianBayesTree


def eliminate(chain: Chain, at: SpinFit, roots: Roots, prior: Prior, name: str) -> Linear:
    """Linearise and eliminate the graph; raise :class:`Unobservable` when the system is singular."""
    blocks = condense(build_jacobian(chain, at, roots), chain.layout.inside)
    graph = gtsam.GaussianFactorGraph()
    for factor in _block_factors(chain, blocks):
        graph.push_back(factor)
    for factor in _prior_factors(chain, at.state, prior):
        graph.push_back(factor)
    # Nested dissection keeps the path from any key to the root short, which makes covariances cheap. QR, not Cholesky:
    # angles at neighbouring keys are tied to each other 1e6 times as closely as to zero.
    ordering = gtsam.Ordering.MetisGaussianFactorGraph(graph)
    try:
        return Linear(blocks, graph.eliminateMultifrontal(ordering, gtsam.EliminateQR))
    except RuntimeError as error:
        raise _rate_not_fixed(name) from error


def _rate_not_fixed(name: str) -> Unobservable:
    return Unobservable(
        f"{name}: the samples do not fix the rate; more of them must give the squared rate, within the range"
    )


def solve_step(chain: Chain, linear: Linear, steps: int) -> SpinState:
    """Return the change of the state to the linear optimum."""
    found = linear.tree.optimize()
    keys = np.array([found.at(K(i)) for i in range(chain.blocks + 1)])
    constants = np.array([found.at(C(s)) for s in range(steps)])
    shared = np.concatenate([keys[:-1], keys[1:], constants[chain.constants_of]], axis=1)
    inside = solve_inside(linear.blocks, shared)
    rates = np.append(np.concatenate([keys[:-1, 1:], inside], axis=1).ravel(), keys[-1, 1])
    return SpinState(float(keys[0, 0]), rates[: len(chain.samples) + 1], constants)


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Standard deviations at the optimum."""

    angle_sd_rad: Floats  # (N,)
    rate_sd_radps: Floats  # (N,)
    constants_sd: Floats  # (11,) in the first step


def compute_accuracy(chain: Chain, linear: Linear, name: str) -> Accuracy:
    """Return the sd of angle, rate and constants; raise :class:`Unobservable` when the covariances do not exist."""
    layout, m, n = chain.layout, chain.layout.m, len(chain.samples)
    try:
        shared = np.array([_shared_covariance(chain, linear, i) for i in range(chain.blocks)])
        constants = linear.tree.marginalCovariance(C(0))
    except RuntimeError as error:
        raise Unobservable(
            f"{name}: the samples determine the rate, but not its covariance; look for long gaps"
        ) from error
    local = np.arange(m)
    wanted = np.zeros((chain.blocks, 2 * m, layout.inside + layout.shared))
    steps = split_blocks(chain.step_s[:-1], m, 0.0)
    wanted[:, :m, layout.angle] = 1.0
    wanted[:, :m, layout.rates[:m]] = steps[:, None, :] * np.tril(np.ones((m, m)))
    wanted[:, m + local, layout.rates[:-1]] = chain.before
    wanted[:, m + local, layout.rates[1:]] += 1 - chain.before
    sd = np.sqrt(compute_variances(linear.blocks, shared, wanted))
    return Accuracy(sd[:, :m].ravel()[:n], sd[:, m:].ravel()[:n], np.sqrt(np.diag(constants)))


def _shared_covariance(chain: Chain, linear: Linear, block: int) -> Floats:
    keys = [K(block), K(block + 1), C(int(chain.constants_of[block]))]
    joint = linear.tree.jointMarginalCovariance(gtsam.KeyVector(keys))
    return np.block([[joint.at(a, b) for b in keys] for a in keys])
