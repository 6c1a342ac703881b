"""From a recording to its reference trajectory, with a stated accuracy."""

from stillpoint.smoother.reference import DEFAULT_METHOD, METHODS, Method, reference
from stillpoint.smoother.rest import RestParams, find_rests

__all__ = ["DEFAULT_METHOD", "METHODS", "Method", "RestParams", "find_rests", "reference"]
