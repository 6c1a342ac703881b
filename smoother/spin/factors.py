"""The graph of a spinning body: angle and rate at every sample, with all that is not known of its sensors.

    K angle and rate at a key, every few samples        C biases, errors of the lever arms, gravity, vibration,
                                                          the encoder's offset and latency: a step every 10 s
          C0 ---------------- C1
        / |  |              |
      K0 ---- K1 ---- K2 ---- K3 ...      each line K-K is one block: its samples of acceleration and squared rate,
      |                                   and the rates inside it, which are taken out exactly (roll_blocks.py)
      where the angle begins

The measurement equations (roll_rows.py) are linearised anew in every iteration, with robust weights: Gauss-Newton with
a line search. gtsam eliminates the keys and gives their covariances.
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
from stillpoint.smoother.spin.blocks import Condensed, condense, inside_of, variances_of
from stillpoint.smoother.spin.chain import Chain, angles_of
from stillpoint.smoother.spin.once_per_turn import Line
from stillpoint.smoother.spin.params import RollGraphParams
from stillpoint.smoother.spin.rows import RollFit, Roots, jacobian
from stillpoint.smoother.spin.samples import RollSamples
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
    RollState,
    in_blocks,
)

HELD = 1e-4  # sd of a constant that is not estimated: as good as none, and no strain on the numbers
ZERO_SD_RAD = 1e-4  # of the first angle where nothing else says where zero is
CONSTANT = 1e-3  # of its sd may a constant change from step to step, for the same reason
CHANGING = 0.3  # of its sd may a vibration
UNTOLD = 0.9  # of the prior's sd: a constant whose sd is still larger is held
FREE_SD_RAD = 10.0  # of an angle that the data has to fix


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known before the data: the angle at the first sample, and the constants around zero."""

    angle_rad: float
    angle_sd_rad: float
    mean: Floats  # (11,)
    cov: Floats  # (11, 11)
    walk_cov: Floats  # (11, 11) from step to step


def prior_of(
    samples: RollSamples, line: Line | None, encoder: bool, angle_rad: float, params: RollGraphParams
) -> Prior:
    """Constants that nothing can tell about are held."""
    p = params.calibration
    sizes, steps = np.full((2, len(CONSTANTS)), HELD)
    mean = np.zeros(len(CONSTANTS))
    free = {ARM_S: p.lever_arm_sd, ARM_A: p.lever_arm_sd}
    gravity = line is not None and line.is_gravity
    if line is not None and line.is_gravity:
        free[AMPLITUDE] = params.harmonic.amplitude_sd_mps2
        mean[AMPLITUDE] = line.gravity_mps2
        # Each channel sees gravity by its own scale and axis, of which the same is known as of the lever arms.
        squared, accel = (np.linalg.norm(k) for k in (samples.squared_gravity, samples.accel_gravity))
        for constant, felt in ((COS_S, squared), (SIN_S, squared), (COS_A, accel), (SIN_A, accel)):
            free[constant] = max(HELD, p.lever_arm_sd * line.gravity_mps2 * float(felt))
    if encoder:
        free[LATENCY] = params.encoder.latency_sd_s
    if encoder and gravity:
        free[OFFSET] = FREE_SD_RAD
    for constant, sd in free.items():
        sizes[constant], steps[constant] = sd, CONSTANT * sd
    if line is not None and line.is_vibration:
        shaken = [COS_S, SIN_S, COS_A, SIN_A]
        mean[shaken], sizes[shaken] = vibration_of(samples, line, params)
        steps[shaken] = CHANGING * sizes[shaken]
    cov, walk = np.diag(sizes**2), np.diag(steps**2)
    bias = samples.bias_per_accel @ samples.bias_per_accel.T  # of biases of 1 m/s^2
    cov[:2, :2] = p.accel_bias_sd_mps2**2 * bias
    walk[:2, :2] = p.accel_bias_walk**2 * p.step_s * bias
    return Prior(angle_rad, FREE_SD_RAD if gravity or encoder else ZERO_SD_RAD, mean, cov, walk)


def vibration_of(samples: RollSamples, line: Line, params: RollGraphParams) -> tuple[Floats, Floats]:
    """Means and sd (4,) of the vibration, cos and sin in the squared rate, then in the acceleration.

    Each accelerometer may be shaken by any amount, so that the line tells nothing of the rate; the true ripple is then
    what is usual, and the vibration of the squared rate is the line less such a ripple.
    """
    mean = np.array([line.squared.real, -line.squared.imag, line.accel.real, -line.accel.imag])
    ripple = 2 * line.rate_radps**2 * params.harmonic.ripple
    free = params.harmonic.amplitude_sd_mps2 * float(np.linalg.norm(samples.bias_per_accel[1]))
    return mean, np.array([ripple, ripple, free, free])


def untold(linear: "Linear", prior: Prior, name: str) -> NDArray[np.bool_]:
    """Which constants (11,) the samples say next to nothing about: their sd is still that of the prior.

    A vibration of the squared rate is always among them: what the samples seem to say of it comes from the angle that
    both vibrations are fitted along, which is not exact. Raises :class:`Unobservable` when the system is singular.
    """
    try:
        found = np.sqrt(np.diag(linear.tree.marginalCovariance(C(0))))
    except RuntimeError as error:
        raise _rate_not_fixed(name) from error
    held = found > UNTOLD * np.sqrt(np.diag(prior.cov))
    held[[COS_S, SIN_S]] = True
    return np.asarray(held)


def holding(prior: Prior, held: NDArray[np.bool_]) -> Prior:
    """The prior with some constants held at their means."""

    def hold(cov: Floats) -> Floats:
        small = np.where(held, CONSTANT, 1.0)
        return np.where(held[:, None] ^ held[None, :], 0.0, cov * np.outer(small, small))

    return replace(prior, cov=hold(prior.cov), walk_cov=hold(prior.walk_cov))


def prior_factors(chain: Chain, state: RollState, prior: Prior) -> Iterator[gtsam.JacobianFactor]:
    """Where the angle begins, and the constants: around their means, and walking from step to step."""
    first = np.array([[1.0, chain.step_s[0]]]) / prior.angle_sd_rad
    off = (prior.angle_rad - angles_of(chain, state)[0]) / prior.angle_sd_rad
    yield gtsam.JacobianFactor(K(0), first, np.array([off]), gtsam.noiseModel.Unit.Create(1))
    unit = gtsam.noiseModel.Unit.Create(len(CONSTANTS))
    root = np.linalg.inv(np.linalg.cholesky(prior.cov))
    yield gtsam.JacobianFactor(C(0), root, root @ (prior.mean - state.constants[0]), unit)
    root = np.linalg.inv(np.linalg.cholesky(prior.walk_cov))
    for s, change in enumerate(np.diff(state.constants, axis=0)):
        yield gtsam.JacobianFactor(C(s), -root, C(s + 1), root, -root @ change, unit)


def prior_cost(chain: Chain, state: RollState, prior: Prior) -> float:
    """Sum of the squares that the prior leaves at a state."""
    return float(sum(np.sum(factor.getb() ** 2) for factor in prior_factors(chain, state, prior)))


def block_factors(chain: Chain, blocks: Condensed) -> Iterator[gtsam.JacobianFactor]:
    """What the samples of each block say about its two keys and the constants."""
    unit = gtsam.noiseModel.Unit.Create(blocks.outer.shape[1])
    for i, (a, b) in enumerate(zip(blocks.outer, blocks.outer_right, strict=True)):
        c = C(int(chain.constants_of[i]))
        yield gtsam.JacobianFactor(K(i), a[:, :2], K(i + 1), a[:, 2:4], c, a[:, 4:], b, unit)


def require_connected_chain(chain: Chain, steps: int, name: str) -> None:
    """Raise :class:`Unobservable` where a block or a step of the constants hangs on nothing; see connectivity.py."""
    links = [[K(i), K(i + 1), C(int(c))] for i, c in enumerate(chain.constants_of)]
    links += [[C(s), C(s + 1)] for s in range(steps - 1)]
    wanted = [key for block in links[: chain.blocks] for key in block]
    require_connected(links, wanted, lambda key: f"the {gtsam.Symbol(key).string()} of the spin", name)


@dataclass(frozen=True, eq=False)
class Linear:
    """The graph linearised at a state, and eliminated."""

    blocks: Condensed
    tree: gtsam.GaussianBayesTree


def eliminated(chain: Chain, at: RollFit, roots: Roots, prior: Prior, name: str) -> Linear:
    """Raises :class:`Unobservable` when the system is singular."""
    blocks = condense(jacobian(chain, at, roots), chain.layout.inside)
    graph = gtsam.GaussianFactorGraph()
    for factor in block_factors(chain, blocks):
        graph.push_back(factor)
    for factor in prior_factors(chain, at.state, prior):
        graph.push_back(factor)
    # Nested dissection: the way from any key to the root is short, which is what covariances cost. QR, not Cholesky:
    # angles at neighbouring keys are tied together 1e6 times as closely as anything ties them to zero.
    ordering = gtsam.Ordering.MetisGaussianFactorGraph(graph)
    try:
        return Linear(blocks, graph.eliminateMultifrontal(ordering, gtsam.EliminateQR))
    except RuntimeError as error:
        raise _rate_not_fixed(name) from error


def _rate_not_fixed(name: str) -> Unobservable:
    return Unobservable(
        f"{name}: the samples do not fix the rate; more of them must give the squared rate, within the range"
    )


def step_of(chain: Chain, linear: Linear, steps: int) -> RollState:
    """The change of the state to the linear optimum."""
    found = linear.tree.optimize()
    keys = np.array([found.at(K(i)) for i in range(chain.blocks + 1)])
    constants = np.array([found.at(C(s)) for s in range(steps)])
    shared = np.concatenate([keys[:-1], keys[1:], constants[chain.constants_of]], axis=1)
    inside = inside_of(linear.blocks, shared)
    rates = np.append(np.concatenate([keys[:-1, 1:], inside], axis=1).ravel(), keys[-1, 1])
    return RollState(float(keys[0, 0]), rates[: len(chain.samples) + 1], constants)


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Standard deviations at the optimum."""

    angle_sd_rad: Floats  # (N,)
    rate_sd_radps: Floats  # (N,)
    constants_sd: Floats  # (11,) in the first step


def accuracy_of(chain: Chain, linear: Linear, name: str) -> Accuracy:
    """Raises :class:`Unobservable` when there are no covariances: a converged solve is no answer until they exist."""
    layout, m, n = chain.layout, chain.layout.m, len(chain.samples)
    try:
        shared = np.array([_shared_covariance(chain, linear, i) for i in range(chain.blocks)])
        constants = linear.tree.marginalCovariance(C(0))
    except RuntimeError as error:
        raise Unobservable(f"{name}: the samples fix the rate, but not how well; look for long gaps") from error
    local = np.arange(m)
    wanted = np.zeros((chain.blocks, 2 * m, layout.inside + layout.shared))
    steps = in_blocks(chain.step_s[:-1], m, 0.0)
    wanted[:, :m, layout.angle] = 1.0
    wanted[:, :m, layout.rates[:m]] = steps[:, None, :] * np.tril(np.ones((m, m)))
    wanted[:, m + local, layout.rates[:-1]] = chain.before
    wanted[:, m + local, layout.rates[1:]] += 1 - chain.before
    sd = np.sqrt(variances_of(linear.blocks, shared, wanted))
    return Accuracy(sd[:, :m].ravel()[:n], sd[:, m:].ravel()[:n], np.sqrt(np.diag(constants)))


def _shared_covariance(chain: Chain, linear: Linear, block: int) -> Floats:
    keys = [K(block), K(block + 1), C(int(chain.constants_of[block]))]
    joint = linear.tree.jointMarginalCovariance(gtsam.KeyVector(keys))
    return np.block([[joint.at(a, b) for b in keys] for a in keys])
