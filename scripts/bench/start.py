"""Times that a user waits at the beginning: for the help page, and for the first results after an installation."""

import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.progress import track

from stillpoint.datasets.machine_code import KERNELS, KERNELS_FROM
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


_COMMAND = "import sys; from stillpoint.scripts.main import main; main(sys.argv[1:])"
# The verbs that compute something, on half a minute and more of a phone, in an order in which each finds its inputs.
VERBS = (
    "simulate phone-1 --minutes 0.6 -o .",
    "info phone-1-seed0.mcap",
    "doctor phone-1-seed0.mcap --force",
    "cut phone-1-seed0.mcap --from 2 --to 20 -o cut",
    "export phone-1-seed0.mcap -o csv",
    "export phone-1-seed0.mcap --format stream -o csv",
    "import csv csv/phone-1-seed0.imu.csv -o in --time t_ns:ns --gyro gx,gy,gz:rad/s --accel ax,ay,az:m/s2",
    "reference phone-1-seed0.mcap --method redistribution -o other --force",
    "reference phone-1-seed0.mcap --force",
    "estimate phone-1-seed0.mcap -e cf --force",
    "estimate phone-1-seed0.mcap -e ekf --force",
    "stream -e cf < csv/phone-1-seed0.stream.csv",
    "stream -e ekf < csv/phone-1-seed0.stream.csv",
    "score phone-1-seed0.mcap --force",
    "validate phone-1-seed0.mcap --method redistribution --force",
    "report phone-1-seed0.mcap",
    "plot phone-1-seed0.mcap --kind errors -o errors.pdf",
    "leaderboard phone-1-seed0.mcap -e cf --jobs 1 -o board --force",
    "export-c -e cf -o c",
)


def bench_start(runs: int) -> list[Timing]:
    """Return the rows of the help page, and of each estimator of attitude with nothing compiled (once each)."""
    rows = [Timing("stillpoint --help", [time_call(lambda: _time_command(_HELP)) for _ in range(runs)], None)]
    ours = [name for name, entry in ESTIMATORS.items() if isinstance(entry, Estimator)]
    for name in track(ours, "start", console=Console(stderr=True), transient=True):
        with tempfile.TemporaryDirectory() as cache:
            empty = {"NUMBA_CACHE_DIR": cache, KERNELS_FROM: cache}
            seconds = [float(json.loads(_time_command(_FIRST, name, **empty))) for _ in range(2)]
        rows.append(Timing(f"first estimate with {name}, nothing compiled", seconds[:1], None))
        rows.append(Timing(f"the next process with {name}", seconds[1:], None))
    return [*rows, *_time_verbs()]


def _time_verbs() -> Iterator[Timing]:
    """Yield the CPU seconds of each verb: with nothing compiled, in the next process, and with kernels where they are.

    On an idle machine they are the time to the first result; other work of the machine does not count.
    """
    has_kernels = any(KERNELS.glob("*.kernel"))
    with tempfile.TemporaryDirectory() as folder:
        for verb in VERBS:
            name = f"stillpoint {verb.partition(' --time')[0]}"
            with tempfile.TemporaryDirectory() as cache:
                empty = {"NUMBA_CACHE_DIR": cache, KERNELS_FROM: cache}
                for when in ("nothing compiled", "the next process"):
                    yield Timing(f"{name}, {when}, CPU", [_time_verb(verb, Path(folder), empty)], None)
            if has_kernels:
                with tempfile.TemporaryDirectory() as cache:
                    seconds = _time_verb(verb, Path(folder), {"NUMBA_CACHE_DIR": cache})
                yield Timing(f"{name}, with kernels, CPU", [seconds], None)


def _time_verb(verb: str, folder: Path, environment: dict[str, str]) -> float:
    """Return the CPU seconds of one verb and of the processes that it starts."""
    words, _, source = verb.partition(" < ")
    given = (folder / source).read_bytes() if source else None
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-c", _COMMAND, *words.split()]
    subprocess.run(command, cwd=folder, input=given, env=os.environ | environment, capture_output=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _time_command(program: str, *words: str, **environment: str) -> str:
    """Run a Python program in a process with these variables, and return what it prints."""
    command = [sys.executable, "-c", program, *words]
    return subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=True).stdout
