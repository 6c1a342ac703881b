"""The errors that a user can correct: each becomes one line on stderr and exit code 2.

A message says what is wrong, where, and what to do about it: ``run7.mcap: time does not rise at sample 2
(0.010000 s); sort or drop the sample first``. Any other exception is a defect of stillpoint (exit code 1).
"""


class StillpointError(Exception):
    """Base of all errors that a user can correct; ``str(error)`` is the one line to show."""


class BadRecording(StillpointError):
    """Arrays of a recording, reference or estimate break a rule of the data types."""


class BadFile(StillpointError):
    """An MCAP file cannot be read or written as the requested kind."""


class BadSource(StillpointError):
    """A source given to an importer lacks something, or contradicts itself."""


class BadParameter(StillpointError):
    """An option, name or value given by the user does not exist or is not allowed."""


class Unobservable(StillpointError):
    """The data does not determine the requested quantity."""
