"""Eliminate the rates inside the blocks exactly, and solve for them afterwards: one QR over all blocks at once.

R of a block's whitened Jacobian [inside, shared | right side] has the rates inside given the shared unknowns on top,

    R_i inside + S shared = d + noise of variance 1,

and below it the block's information on the shared unknowns: the factor that the graph gets. Nothing is lost; the
optimum and its covariance are those of the full system.
"""

from dataclasses import dataclass

import numpy as np

from stillpoint.datasets.recording import Floats


@dataclass(frozen=True, eq=False)
class Condensed:
    """B blocks, with i unknowns inside and s shared ones."""

    inner: Floats  # (B, i, i) R_i, upper triangular
    coupling: Floats  # (B, i, s) S
    inner_right: Floats  # (B, i) d
    outer: Floats  # (B, r, s) the factor, of r <= s rows
    outer_right: Floats  # (B, r)


def condense(rows: Floats, inside: int) -> Condensed:
    """Return the blocks condensed; ``rows`` (B, rows, i + s + 1) are whitened Jacobians with their right sides."""
    r = np.asarray(np.linalg.qr(rows, mode="r"))
    s = rows.shape[2] - inside - 1
    inner, outer = r[:, :inside], r[:, inside : inside + s, inside:]
    return Condensed(inner[:, :, :inside], inner[:, :, inside:-1], inner[:, :, -1], outer[:, :, :-1], outer[:, :, -1])


def solve_inside(condensed: Condensed, shared: Floats) -> Floats:
    """Return the unknowns inside (B, i) for shared unknowns (B, s)."""
    right = condensed.inner_right - np.einsum("bis,bs->bi", condensed.coupling, shared)
    return np.asarray(np.linalg.solve(condensed.inner, right[:, :, None])[:, :, 0])


def compute_variances(condensed: Condensed, shared_cov: Floats, wanted: Floats) -> Floats:
    """Return variances (B, w) of the combinations ``wanted`` (B, w, i + s), given the shared covariances (B, s, s).

    inside = R_i^-1 (d + noise - S shared): each combination is one of unit noise and of the shared unknowns.
    """
    inside = condensed.inner.shape[1]
    of_noise = np.linalg.solve(condensed.inner.transpose(0, 2, 1), wanted[:, :, :inside].transpose(0, 2, 1))
    of_shared = wanted[:, :, inside:] - of_noise.transpose(0, 2, 1) @ condensed.coupling
    own = np.sum(of_noise**2, axis=1)
    return np.asarray(own + np.sum((of_shared @ shared_cov) * of_shared, axis=2))
