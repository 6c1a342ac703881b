"""Find the field of a long recording disturbed without solving the whole recording for every prior of the sensors.

The start value tells a disturbed field from a gyro that is off: its blocks of 12 s take attitudes from field and
specific force and carry no error on. With a gyro 8 % off, 0.996 of the readings lie within 12 uT of it (a simulated
hour); in a field that wanders by 10 uT, 0.31 do. Where it finds the field disturbed, a part of the recording tries all
priors, and the verdict on that part counts for the whole.
"""

import numpy as np

from stillpoint.datasets.frames import rotation
from stillpoint.smoother.attitude.evidence import Evidence
from stillpoint.smoother.attitude.magnetometer import compute_residuals, find_inliers
from stillpoint.smoother.attitude.params import GraphParams
from stillpoint.smoother.attitude.plausibility import INLIER_SHARE
from stillpoint.smoother.attitude.windows import split_windows

_MOTION_S = 300.0  # that a trial contains: the limits of plausibility.py were found on recordings of 60 to 300 s


def find_trial(evidence: Evidence, params: GraphParams) -> Evidence | None:
    """Return the evidence of the part on which the priors are tried; None where the whole recording is to try them.

    That is so in a recording of one window, and where the start value finds the field undisturbed.
    """
    windows = split_windows(evidence.keys, params.keys)
    if len(windows) == 1 or not _starts_disturbed(evidence, params):
        return None
    moved_s = np.cumsum(np.where(evidence.keys.at_rest, 0.0, evidence.keys.span_s))
    end = int(np.searchsorted(moved_s, _MOTION_S)) + 1
    return evidence.within(0, min(end, windows[0][1]))


def _starts_disturbed(evidence: Evidence, params: GraphParams) -> bool:
    """Return whether too few readings of the magnetometer fit the start value."""
    measured = evidence.measured
    if measured is None or evidence.field_start is None:
        return False
    rotations = rotation(evidence.q_nb[measured.state]).as_matrix()
    residual_ut = compute_residuals(measured, rotations, evidence.field_start)
    return bool(find_inliers(residual_ut, params.magnetic).mean() < INLIER_SHARE)
