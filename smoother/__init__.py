"""From a recording to its reference trajectory, with a stated accuracy."""

from stillpoint.smoother.reference import (
    DEFAULT_METHOD,
    METHODS,
    ROLL_METHODS,
    Method,
    attitude_reference,
    reference,
)
from stillpoint.smoother.rest import RestParams, find_rests

__all__ = [
    "DEFAULT_METHOD",
    "METHODS",
    "ROLL_METHODS",
    "Method",
    "RestParams",
    "attitude_reference",
    "find_rests",
    "reference",
]
