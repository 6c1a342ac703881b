"""Streaming estimators of attitude, and of the angle of a spinning body.

``estimate(recording, name)`` runs one over a recording. ``Stream(name)`` and ``SpinStream(name, geometry)`` run one
sample by sample. ``ESTIMATORS`` lists them.
"""

from stillpoint.filters.run import estimate
from stillpoint.filters.spin.advance import SpinAnswer
from stillpoint.filters.spin.stream import SavedSpin, SpinStream
from stillpoint.filters.stream import Saved, Stream
from stillpoint.filters.table import ESTIMATORS

__all__ = ["ESTIMATORS", "Saved", "SavedSpin", "SpinAnswer", "SpinStream", "Stream", "estimate"]
