"""Kernels that come with the package: used where all that they depend on is the same, and only there.

What this uses of numba is private (``FunctionCache``, ``_cache``, ``_compile_for_args``, ``_insert``): checked with
numba 0.68.1. A numba that has renamed one of them fails here.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from stillpoint.datasets.machine_code import ANNOUNCE, KERNELS_FROM, TARGET

CALL = """
import sys
if sys.argv[1] == "other sources":
    from stillpoint.datasets import machine_code
    machine_code.hash_sources = lambda folder: "other"
from stillpoint.filters.spin import front
state = front.start()
print(state.t_ns, sum(front.start.stats.cache_hits.values()))
"""


def call(kernels: Path, cache: Path, how: str = "", **environment: str) -> tuple[str, str]:
    """Start a process with this cache that calls a compiled function; return its output and what it said."""
    env = {**os.environ, "NUMBA_CACHE_DIR": str(cache), KERNELS_FROM: str(kernels), ANNOUNCE: "1", **environment}
    done = subprocess.run([sys.executable, "-c", CALL, how], env=env, capture_output=True, text=True, check=True)
    return done.stdout.strip(), done.stderr


@pytest.mark.slow
def test_a_kernel_is_loaded_into_an_empty_cache_and_not_for_other_sources(tmp_path: Path) -> None:
    kernels = tmp_path / "kernels"
    kernels.mkdir()
    generic = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", TARGET: str(kernels)}
    assert call(kernels, tmp_path / "a", **generic) == ("-1 0", "compiling, once (about 15 s)\n")
    assert list(kernels.glob("*.kernel"))
    assert call(kernels, tmp_path / "b") == ("-1 1", "")
    assert call(kernels, tmp_path / "c", "other sources")[0] == "-1 0"
    assert call(kernels, tmp_path / "b") == ("-1 1", "")


COMPILE = """
import sys, time
from pathlib import Path
from stillpoint.filters.spin import front
Path(sys.argv[1], sys.argv[2]).touch()
while len(list(Path(sys.argv[1]).glob("ready-*"))) < 2:
    time.sleep(0.001)
front.start()
print(sum(front.start.stats.cache_misses.values()), sum(front.start.stats.cache_hits.values()))
"""


@pytest.mark.slow
def test_of_two_processes_that_want_a_function_one_compiles_and_the_other_loads(tmp_path: Path) -> None:
    """Both begin when both have started: compiling takes much longer than to look for machine code and lock it."""
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), KERNELS_FROM: str(tmp_path / "none")}
    command = [sys.executable, "-c", COMPILE, str(tmp_path)]
    both = [subprocess.Popen([*command, f"ready-{k}"], env=env, stdout=subprocess.PIPE, text=True) for k in range(2)]
    counts = [tuple(map(int, process.communicate()[0].split())) for process in both]
    assert sorted(counts) == [(0, 1), (1, 0)]
