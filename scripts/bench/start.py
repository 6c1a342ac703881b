"""Times that a user waits at the beginning: for the help page, and for the first estimate after an installation."""

import json
import os
import subprocess
import sys
import tempfile

from rich.console import Console
from rich.progress import track

from stillpoint.filters import ESTIMATORS
from stillpoint.filters.table import Estimator
from stillpoint.scripts.bench.timing import Timing, time_call

_HELP = "import sys; from stillpoint.scripts.main import main; main(['--help'])"
# The imports count too: they are part of what a user waits for. Simulated data and the interpreter do not.
_FIRST = """
import json, sys, time
start = time.perf_counter()
from stillpoint.datasets import Recording
from stillpoint.filters import estimate
n = 1000
recording = Recording.from_arrays(
    "rest", [k / 100 for k in range(n)], [[0.0] * 3] * n, [[0.0, 0.0, 9.81]] * n, [[0.0, 20.0, -40.0]] * n
)
estimate(recording, sys.argv[1])
print(json.dumps(time.perf_counter() - start))
"""


def bench_start(runs: int) -> list[Timing]:
    """Return the rows of the help page, and of each estimator of attitude with nothing compiled (once each)."""
    rows = [Timing("stillpoint --help", [time_call(lambda: _time_command(_HELP)) for _ in range(runs)], None)]
    ours = [name for name, entry in ESTIMATORS.items() if isinstance(entry, Estimator)]
    for name in track(ours, "start", console=Console(stderr=True), transient=True):
        with tempfile.TemporaryDirectory() as cache:
            seconds = [float(json.loads(_time_command(_FIRST, name, NUMBA_CACHE_DIR=cache))) for _ in range(2)]
        rows.append(Timing(f"first estimate with {name}, nothing compiled", seconds[:1], None))
        rows.append(Timing(f"the next process with {name}", seconds[1:], None))
    return rows


def _time_command(program: str, *words: str, **environment: str) -> str:
    command = [sys.executable, "-c", program, *words]
    return subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=True).stdout
