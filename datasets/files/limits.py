"""How much memory an input may claim. A small file can claim terabytes; a limit makes that one line of error.

Each limit is far above what real recordings need. The environment variable :data:`LARGE`, which the flag ``--large``
sets for a command and its worker processes, multiplies all of them by :data:`_LARGE_FACTOR`.
"""

import os

LARGEST_CHUNK = 64 << 20  # bytes of an MCAP or bag chunk, unpacked: recorders write 1-4 MiB
_MOST_COMPRESSION = 64  # what claims more must have a 64th of it in bytes: sensor data packs 2-10 times
LARGEST_MEMBER = 1 << 30  # bytes of one zip, unpacked, or of one text file: ten hours of a phone's sensors
LARGEST_LINE = 1 << 20  # characters of one line of text: a row of a log has some hundred
LARGE = "STILLPOINT_LARGE"
_LARGE_FACTOR = 64


def raise_limit(limit: int) -> int:
    """Return a limit, raised where the user allows large inputs."""
    return limit * (_LARGE_FACTOR if os.environ.get(LARGE) else 1)


def limit_chunk(packed: int) -> int:
    """Return how many bytes a chunk, or a file in a zip, of ``packed`` compressed bytes may claim to hold."""
    return max(raise_limit(LARGEST_CHUNK), _MOST_COMPRESSION * packed)
