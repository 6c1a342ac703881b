"""``python tests/support/hash_outputs.py``: a hash of every output, to compare before and after code is moved.

Prints a line for each input recording, reference method, and estimator in batch and as a stream, in double and single
precision: five simulated recordings, and five real ones where STILLPOINT_DATA names their folder. An output that raises
is named by its error. Lines of two commits can be compared with ``diff`` on one machine only: other processors round
otherwise.
"""

import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent / "recordings"))

import numpy as np
from motions import feed

from stillpoint.datasets import Recording, StillpointError
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import ESTIMATORS, SpinStream, Stream, estimate
from stillpoint.filters.table import SPINS, Estimator, SpinEstimator
from stillpoint.smoother import METHODS, reference
from stillpoint.smoother.reference import SPIN_METHODS

SIMULATED = {
    "phone-1": 1.5,
    "phone-3-shaken": 1.5,
    "auv-dolphin": 6.0,
    "servo-bench": 2.5,
    "spin-variable": 0.2,
}  # minutes
REAL = (
    ("broad", "broad/04_undisturbed_slow_rotation_with_breaks_A.mat"),
    ("broad", "broad/28_disturbed_stationary_magnet_A.mat"),
    ("tyrex", "tyrex/android/Guillaume_Nexus5_NoDist_RunningHand"),
    ("bench", "bench/full-sphere"),
    ("flatball", "disc/2025-08-31-001-rb.csv"),
)
SETTINGS_AND_WORDS = ("name", "params", "diagnostics", "made_from", "recording", "ns_per_sample")


def main() -> int:
    """Print all lines; return the exit code."""
    for name, recording in _list_recordings():
        print(f"{hash_arrays(recording)} {name} recording", flush=True)
        for what, make in _list_outputs(recording):
            try:
                found = hash_arrays(make())
            except StillpointError as error:
                found = f"{type(error).__name__:64}"
            print(f"{found} {name} {what}", flush=True)
    return 0


def _list_recordings() -> Iterator[tuple[str, Recording]]:
    for name, minutes in SIMULATED.items():
        yield name, simulate(name, seed=1, minutes=minutes)
    if folder := os.environ.get("STILLPOINT_DATA"):
        for kind, path in REAL:
            importer = IMPORTERS[kind]
            item = next(iter(importer.find_items(Path(folder) / path)))
            yield Path(path).stem, importer.read_one(item, importer.options()).recording


def _list_outputs(recording: Recording) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield each output of a recording: what it is, and the function that makes it."""
    of_spin = recording.imu is None
    for method in SPIN_METHODS if of_spin else METHODS:
        yield f"{method} reference", lambda method=method: reference(recording, method)
    for name in SPINS if of_spin else [name for name in ESTIMATORS if name not in SPINS]:
        streams = isinstance(ESTIMATORS[name], Estimator | SpinEstimator)
        for precision in ("double", "single") if streams else ("double",):
            yield f"{name} batch {precision}", lambda n=name, p=precision: estimate(recording, n, precision=p)
            if streams:
                yield f"{name} stream {precision}", lambda n=name, p=precision: run_stream(recording, n, p)


def run_stream(recording: Recording, name: str, precision: str) -> Any:
    """Return what a stream says, sample by sample: quaternions (N, 4), or angle, rate and their variances (N, …)."""
    if recording.imu is not None:
        return feed(Stream(name, precision=precision), recording)
    spin = recording.spin
    stream = SpinStream(name, spin.geometry, precision=precision)
    rows = zip(spin.t_ns.tolist(), spin.accel_mps2, spin.gyro_radps, strict=True)
    return np.array([tuple(stream.update(*row)) for row in rows], dtype=np.float64)


def hash_arrays(thing: Any) -> str:
    """Return the SHA-256 of all arrays in an object, by name; settings, names and diagnostics do not count."""
    digest = sha256()
    for name, array in _list_arrays(thing, ""):
        digest.update(f"{name} {array.dtype} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _list_arrays(thing: Any, name: str) -> Iterator[tuple[str, Any]]:
    if isinstance(thing, np.ndarray):
        yield name, thing
    elif is_dataclass(thing):
        for each in fields(thing):
            if each.name not in SETTINGS_AND_WORDS:
                yield from _list_arrays(getattr(thing, each.name), f"{name}.{each.name}")


if __name__ == "__main__":
    sys.exit(main())
