"""Compile the kernels that come with the package: ``python -m stillpoint.scripts.kernels``.

They are compiled in double precision for any processor of this platform, in processes of their own. A wheel that is
built afterwards carries them (:mod:`stillpoint.datasets.machine_code`).
"""

import hashlib
import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

import numba

from stillpoint.datasets.machine_code import KERNELS, TARGET, hash_sources
from stillpoint.scripts.program import run_program

_SOURCES = Path(__file__).parents[1]
_REFERENCE = "reference"
_PROCESSES_AT_MOST = 4  # they share most functions, and wait for each other's


def main() -> int:
    """Compile all kernels into the package's folder; return the exit code."""
    from stillpoint.filters import ESTIMATORS

    stamp, made_from = KERNELS / "made-from.sha256", _hash_inputs()
    if stamp.is_file() and stamp.read_text() == made_from:
        print(f"the kernels in {KERNELS} are those of these sources")
        return 0
    try:
        KERNELS.mkdir(exist_ok=True)
        for old in (stamp, *KERNELS.glob("*.kernel")):
            old.unlink(missing_ok=True)
    except OSError as error:
        print(f"{KERNELS}: cannot be written ({error.strerror}); numba compiles at the first call", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as own_cache:
        # numba reads these when it is imported: in the processes of the pool, which begin afresh.
        os.environ |= {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": own_cache}
        os.environ[TARGET] = str(KERNELS)
        count = min(os.cpu_count() or 1, _PROCESSES_AT_MOST)
        with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as processes:
            running = [processes.submit(_compile, name) for name in (_REFERENCE, *ESTIMATORS)]
            for done in as_completed(running):
                done.result()
    stamp.write_text(made_from)
    kept = sorted(KERNELS.glob("*.kernel"))
    print(f"{len(kept)} kernels, {sum(path.stat().st_size for path in kept) / 1e6:.1f} MB in {KERNELS}")
    return 0


def _hash_inputs() -> str:
    """Return a digest of what the kernels are compiled from, and with."""
    folders = [hash_sources(_SOURCES / name) for name in ("datasets", "filters", "scoring", "smoother")]
    return hashlib.sha256("\n".join([*folders, numba.__version__, sys.version]).encode()).hexdigest()


def _compile(name: str) -> None:
    """Run an estimator, in batch and as a stream, or the reference on a short simulated recording."""
    from stillpoint.datasets.simulate import simulate
    from stillpoint.filters import ESTIMATORS, SpinStream, Stream, estimate
    from stillpoint.filters.table import Estimator, SpinEstimator

    entry = ESTIMATORS.get(name)
    if isinstance(entry, SpinEstimator):
        spin = simulate("spin-constant", minutes=0.01)
        assert spin.spin is not None
        estimate(spin, name)
        SpinStream(name, spin.spin.geometry).save()
        return
    phone = simulate("phone-1", minutes=0.6)
    if isinstance(entry, Estimator):
        estimate(phone, name)
        stream = Stream(name)
        stream.update(0, (0.0, 0.0, 0.0), (0.0, 0.0, 9.81), (0.0, 20.0, -44.0))
        stream.save()
    elif name == _REFERENCE:
        try:
            from stillpoint.smoother import reference
        except ImportError:  # gtsam has no wheel here
            return
        reference(phone)


if __name__ == "__main__":
    run_program(main)
