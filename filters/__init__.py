"""Streaming estimators of attitude: ``estimate(recording, name)`` for every name in ``ESTIMATORS``."""

from stillpoint.filters.run import estimate
from stillpoint.filters.table import ESTIMATORS

__all__ = ["ESTIMATORS", "estimate"]
