"""The 48 ways in which axes are swapped and flipped, and which of them the data asks for."""

import itertools
from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.recording import Floats

# Log-likelihoods, in nats. Measured on 22 real recordings: see docs/doctor.md.
MIN_GAIN = 0.3  # per window, over "the gyro has nothing to do with it": below, nothing is said
MIN_FAULT_GAIN = 0.6  # ... and below this no fault is claimed
MIN_ADVANTAGE = 0.15  # per window, of another candidate over the identity: below, the axes are right
TIE_NATS, TIE_SIGMA = 5.0, 4.0  # closer to the best than either: as good, and the simplest of them is taken


def _signed_permutations() -> Floats:
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            found.append(matrix)
    return np.array(sorted(found, key=complexity))


def complexity(matrix: Floats) -> tuple[int, int]:
    """How much a signed permutation changes: moved axes and flipped signs together, then the moved axes alone."""
    moved = int((np.abs(np.diag(matrix)) < 0.5).sum())
    flipped = int((matrix < -0.5).sum())
    return moved + flipped, moved


CANDIDATES: Floats = _signed_permutations()  # (48, 3, 3), the identity first, then by complexity
IDENTITY = 0


def index_of(matrix: Floats) -> int:
    """Place of a signed permutation among the candidates."""
    return int(np.abs(CANDIDATES - matrix).sum(axis=(1, 2)).argmin())


def describe(sensor: str, matrix: Floats) -> str:
    """``gyro x -> -x`` for each component that changes: the corrected x is minus the measured x."""
    parts = []
    for axis, row in zip("xyz", matrix, strict=True):
        source = int(np.abs(row).argmax())
        name = ("-" if row[source] < 0 else "") + "xyz"[source]
        if name != axis:
            parts.append(f"{sensor} {axis} -> {name}")
    return ", ".join(parts)


@dataclass(frozen=True)
class Choice:
    """The simplest candidate that fits as well as the best one."""

    matrix: Floats  # (3, 3) signed permutation: true = matrix @ measured, up to a factor
    gain: float  # mean log-likelihood per window over the null
    tested: tuple[bool, bool, bool]  # would a flip of this measured axis have been seen?


def choose(loss: Floats, null: Floats, overlap: float) -> Choice | None:
    """Pick from the losses (48, n) of the candidates over n windows; None when no candidate explains the data.

    ``null`` (n,) is the loss without the gyro. ``overlap``: how many windows share the same data.
    """
    mean = loss.mean(axis=1)
    best = int(mean.argmin())
    gain = float(null.mean() - mean[best])
    if gain < MIN_GAIN or not _worse(null - loss[best], overlap):
        return None
    chosen = next(k for k in range(len(loss)) if k == best or not _worse(loss[k] - loss[best], overlap))
    if mean[IDENTITY] - mean[best] < MIN_ADVANTAGE:
        chosen = IDENTITY
    if chosen != IDENTITY and gain < MIN_FAULT_GAIN:
        return None
    flips = [index_of(CANDIDATES[chosen] @ np.diag(sign)) for sign in 1 - 2 * np.eye(3)]
    tested = [_worse(loss[k] - loss[chosen], overlap) for k in flips]
    return Choice(CANDIDATES[chosen], gain, (tested[0], tested[1], tested[2]))


def _worse(difference: Floats, overlap: float) -> bool:
    """Is the first of two candidates clearly worse, by the differences of their losses over the windows?"""
    error = difference.std() * np.sqrt(overlap / len(difference))
    nats = difference.sum() / overlap
    return bool(difference.mean() > TIE_SIGMA * error or nats > TIE_NATS)
