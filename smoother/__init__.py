"""From a recording to its reference trajectory, with a stated accuracy."""

from typing import TYPE_CHECKING, Any

from stillpoint.smoother.reference import (
    DEFAULT_METHOD,
    METHODS,
    SPIN_METHODS,
    Method,
    attitude_reference,
    reference,
)
from stillpoint.smoother.rest import RestParams, find_rests

if TYPE_CHECKING:
    from stillpoint.smoother.attitude.outside.added import States


def __getattr__(name: str) -> Any:
    """Load ``States`` when it is asked for: gtsam is not available everywhere."""
    if name != "States":
        raise AttributeError(f"module 'stillpoint.smoother' has no attribute {name!r}")
    from stillpoint.smoother.attitude.outside.added import States

    return States


__all__ = [
    "DEFAULT_METHOD",
    "METHODS",
    "SPIN_METHODS",
    "Method",
    "RestParams",
    "States",
    "attitude_reference",
    "find_rests",
    "reference",
]
