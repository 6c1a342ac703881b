"""What a user can put right: each of these becomes one line on stderr and exit code 2.

A message says what is wrong, where, and what to do about it: ``run7.mcap: time does not rise at sample 2
(0.010000 s); sort or drop the sample first``. Any other exception is a defect of stillpoint (exit code 1).
"""


class StillpointError(Exception):
    """Base of all errors that a user can put right; ``str(error)`` is the one line to show."""


class BadRecording(StillpointError):
    """The arrays of a recording, reference or estimate break a rule of the vocabulary."""


class BadFile(StillpointError):
    """An MCAP file cannot be read or written as what was asked for."""


class BadSource(StillpointError):
    """A source given to an importer lacks something, or contradicts itself."""


class BadParameter(StillpointError):
    """An option, name or value that the user gave is not one there is."""


class Unobservable(StillpointError):
    """The data does not fix what was asked for: there is no answer to give."""
