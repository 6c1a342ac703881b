"""Compile the kernels that come with the package: ``python -m stillpoint.scripts.kernels``.

They are compiled in double precision for any processor of this platform, in a process of its own. A wheel that is built
afterwards carries them (:mod:`stillpoint.datasets.machine_code`).
"""

import os
import subprocess
import sys
import tempfile

from stillpoint.datasets.machine_code import KERNELS, TARGET


def main() -> int:
    """Compile all kernels into the package's folder; return the exit code."""
    KERNELS.mkdir(exist_ok=True)
    for old in KERNELS.glob("*.kernel"):
        old.unlink()
    with tempfile.TemporaryDirectory() as own_cache:
        generic = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": own_cache}
        program = f"from stillpoint.scripts.kernels import {_compile_all.__name__} as run; run()"
        command = [sys.executable, "-c", program]
        code = subprocess.run(command, env=os.environ | generic | {TARGET: str(KERNELS)}, check=False).returncode
    kept = sorted(KERNELS.glob("*.kernel"))
    print(f"{len(kept)} kernels, {sum(path.stat().st_size for path in kept) / 1e6:.1f} MB in {KERNELS}")
    return code


def _compile_all() -> None:
    """Call every estimator, in batch and as a stream, and the reference, on short simulated recordings."""
    from stillpoint.datasets.simulate import simulate
    from stillpoint.filters import ESTIMATORS, SpinStream, Stream, estimate
    from stillpoint.filters.table import Estimator, SpinEstimator

    phone, spin = simulate("phone-1", minutes=0.6), simulate("spin-constant", minutes=0.01)
    for name, entry in ESTIMATORS.items():
        print(name, flush=True)
        if isinstance(entry, Estimator):
            estimate(phone, name)
            stream = Stream(name)
            stream.update(0, (0.0, 0.0, 0.0), (0.0, 0.0, 9.81), (0.0, 20.0, -44.0))
            stream.save()
        elif isinstance(entry, SpinEstimator):
            assert spin.spin is not None
            estimate(spin, name)
            SpinStream(name, spin.spin.geometry).save()
    try:
        from stillpoint.smoother import reference
    except ImportError:  # gtsam has no wheel here
        return
    reference(phone)


if __name__ == "__main__":
    sys.exit(main())
