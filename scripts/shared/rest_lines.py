"""The rests of a recording as ``info``, ``doctor`` and ``demo`` tell them."""

from stillpoint.datasets.recording import Recording, Times
from stillpoint.smoother import find_rests
from stillpoint.smoother.attitude.satellite import not_under_way


def rests_of(recording: Recording) -> Times:
    """First and last stamp of each rest (R, 2), as the reference takes them by default.

    Those while satellites see the body under way are left out: an even course looks like rest to an IMU.
    """
    return not_under_way(find_rests(recording.require_imu()), recording.gps)
