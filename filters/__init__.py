"""Streaming estimators of attitude.

``estimate(recording, name)`` runs one over a recording, ``Stream(name)`` sample by sample; ``ESTIMATORS`` lists them.
"""

from stillpoint.filters.run import estimate
from stillpoint.filters.stream import Saved, Stream
from stillpoint.filters.table import ESTIMATORS

__all__ = ["ESTIMATORS", "Saved", "Stream", "estimate"]
