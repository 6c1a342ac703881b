"""From a recording to its reference trajectory."""

from stillpoint.smoother.rest import RestParams, find_rests

__all__ = ["RestParams", "find_rests"]
