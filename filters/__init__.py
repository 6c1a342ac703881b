"""Streaming estimators of attitude, and of roll.

``estimate(recording, name)`` runs one over a recording, ``Stream(name)`` and ``RollStream(name, geometry)`` sample by
sample; ``ESTIMATORS`` lists them.
"""

from stillpoint.filters.run import estimate
from stillpoint.filters.spin.advance import RollAnswer
from stillpoint.filters.spin.stream import RollStream, SavedRoll
from stillpoint.filters.stream import Saved, Stream
from stillpoint.filters.table import ESTIMATORS

__all__ = ["ESTIMATORS", "RollAnswer", "RollStream", "Saved", "SavedRoll", "Stream", "estimate"]
