"""The graph of a stretch of a recording, and the values that the optimiser starts from."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from itertools import chain

import gtsam
import numpy as np
from gtsam.symbol_shorthand import H, L, X

from stillpoint.datasets.earth import local_declination
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.recording import Floats, Recording
from stillpoint.smoother.attitude import factors
from stillpoint.smoother.attitude.chain import Chain, build_chain
from stillpoint.smoother.attitude.evidence import Evidence, gravity_mps2, has_known_base_pose
from stillpoint.smoother.attitude.linear.inherited import Inherited
from stillpoint.smoother.attitude.magnetometer import field_prior
from stillpoint.smoother.attitude.outside.satellite import fix_factors, lone_stretch_factors
from stillpoint.smoother.attitude.params import GraphParams

_UNKNOWN_RAD = 2.0  # sd of an angle about which nothing is known
_DEFINED_RAD = 1e-3  # sd of a heading that the first attitude defines


@dataclass(frozen=True, eq=False)
class Graph:
    """All factors but those of the magnetometer: those of the chain of states as arrays, the others as gtsam's."""

    chain: Chain
    others: gtsam.NonlinearFactorGraph
    inherited: Inherited | None = None  # from the windows before


def build_graph(recording: Recording, evidence: Evidence, bias_b_radps: Floats, params: GraphParams) -> Graph:
    """Return all factors on the states of ``evidence`` but those of the magnetometer and of the returns' votes.

    Two disjoint stretches of states have no factor in common. ``bias_b_radps`` (3,) is the gyro bias about which the
    IMU is preintegrated.
    """
    keys = evidence.keys
    everything: Iterable[gtsam.NonlinearFactor] = chain(
        factors.bias_factors(keys, bias_b_radps, params),
        () if evidence.fixes is None else fix_factors(evidence.fixes, params.gps),
        () if evidence.fixes is None else lone_stretch_factors(keys, evidence.fixes, params.motion),
        factors.rest_factors(keys, params),
        factors.gap_factors(keys, params),
        factors.anchor_factors(_find_anchors(recording, evidence, params), params),
    )
    others = gtsam.NonlinearFactorGraph()
    for factor in everything:
        others.push_back(factor)
    if evidence.field_start is not None and keys.first == 0:
        azimuth, _ = local_declination(recording.info)
        azimuth_known = not has_known_base_pose(recording, evidence)
        others.push_back(field_prior(evidence.field_start, azimuth, azimuth_known, params.magnetic))
    g_mps2, bounded = gravity_mps2(recording.info), evidence.fixes is None
    return Graph(build_chain(evidence.motion, keys, bias_b_radps, g_mps2, bounded, params), others)


def build_start_values(
    evidence: Evidence, q_nb: Floats, bias_b_radps: Floats, effective: Collection[int], params: GraphParams
) -> gtsam.Values:
    """Return start values of all unknowns of a window, with attitudes ``q_nb`` (n, 4) and gyro bias (3,).

    Of the effective biases only those of the intervals ``effective`` are among them.
    """
    values = factors.start_values(
        evidence.keys, q_nb, evidence.place_n_m, evidence.velocity_n_mps, bias_b_radps, effective, params
    )
    if evidence.field_start is not None:
        values.insert(H(0), evidence.field_start)
    base = evidence.return_states()[0]
    if base is not None and evidence.find_votes() is not None and base in evidence.keys.held:
        values.insert(L(0), values.atPose3(X(base)))
    return values


def _find_anchors(recording: Recording, evidence: Evidence, params: GraphParams) -> factors.Anchors:
    """Return the states in the base pose, and how well the first attitude is known."""
    keys = evidence.keys
    base = evidence.return_states()[0]
    known_pose = has_known_base_pose(recording, evidence)
    absolute = evidence.field_start is not None or evidence.fixes is not None or known_pose
    spread = np.diag([_UNKNOWN_RAD**2, _UNKNOWN_RAD**2, _UNKNOWN_RAD**2 if absolute else _DEFINED_RAD**2])
    turn = rotation(evidence.q_nb[0]).as_matrix()
    return factors.Anchors(
        base=base,
        base_q_nb=recording.base_pose if base in keys.states else None,
        base_sd_rad=params.returns.repeat_sd_rad,
        first_q_nb=evidence.q_nb[0] if keys.first == 0 else None,
        first_cov_b_rad2=turn.T @ spread @ turn,
    )
