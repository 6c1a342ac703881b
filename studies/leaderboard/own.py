"""One's own estimator: a function of a recording, or an object that takes one sample at a time.

A function is called with the recording and returns an :class:`Estimate`, or quaternions (N, 4) at the N samples of the
IMU. A class is made anew, without arguments, for each recording; its ``update(t_s, gyro_b_radps, accel_b_mps2,
mag_b_ut)`` is called at each IMU sample, with None instead of the field where there is no new one, and returns a
quaternion. Quaternions are wxyz and take body vectors to East-North-Up; their length is normalised.
"""

import hashlib
import importlib
import importlib.util
import sys
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter_ns
from typing import Any

import numpy as np

from stillpoint.datasets.errors import BadParameter, BadRecording, StillpointError
from stillpoint.datasets.recording import Floats, Recording
from stillpoint.datasets.trajectory import Estimate
from stillpoint.filters.front.sources import choose_magnetometer, newest_rows


def load_own(target: str) -> Any:
    """Return the function or class ``FILE.py:NAME`` or ``MODULE:NAME``.

    Raises :class:`BadParameter` when the file, module or name does not exist or its import fails.
    """
    place, _, name = target.rpartition(":")
    try:
        module = _load_file(Path(place)) if place.endswith(".py") else importlib.import_module(place)
    except FileNotFoundError:
        raise BadParameter(f"{target}: there is no file {place}; write FILE.py:NAME or MODULE:NAME") from None
    except StillpointError:
        raise
    except Exception as error:
        raise BadParameter(f"{target}: cannot be imported ({type(error).__name__}: {error})") from None
    if not callable(getattr(module, name, None)):
        raise BadParameter(f"{target}: {place} has no function or class {name}")
    return getattr(module, name)


def hash_own(target: str) -> str:
    """Return the SHA-256 of the source file of ``FILE.py:NAME`` or ``MODULE:NAME``; checks that it can be loaded."""
    load_own(target)
    place = target.rpartition(":")[0]
    if place.endswith(".py"):
        return hashlib.sha256(Path(place).read_bytes()).hexdigest()
    origin = getattr(importlib.import_module(place), "__file__", None)
    return hashlib.sha256(Path(origin).read_bytes()).hexdigest() if origin else ""


def run_own(own: Any, target: str, name: str, recording: Recording) -> Estimate:
    """Run one's own estimator over a recording; an exception in it becomes a :class:`BadRecording` that names it."""
    imu = recording.require_imu()
    begun = perf_counter_ns()
    try:
        instance = own() if isinstance(own, type) else own
        made = _run_samples(instance, recording) if hasattr(instance, "update") else instance(recording)
    except StillpointError:
        raise
    except (Exception, SystemExit) as error:
        raise BadRecording(f"{target}: {_describe(error)}") from error
    ns_per_sample = (perf_counter_ns() - begun) / len(imu.t_ns)
    if isinstance(made, Estimate):
        return replace(made, name=name, recording=recording.name)
    q_nb = _check_quaternions(made, len(imu.t_ns), target)
    return Estimate(imu.t_ns, name, q_nb=q_nb, recording=recording.name, ns_per_sample=ns_per_sample)


def _run_samples(instance: Any, recording: Recording) -> Floats:
    """Feed an object with the samples in the order of their stamps; an uncalibrated magnetometer is left out."""
    imu = recording.require_imu()
    mag, _, _ = choose_magnetometer(recording)
    rows = np.full(len(imu.t_ns), -1) if mag is None else newest_rows(mag.t_ns, imu.t_ns)
    t_s = (imu.t_ns - imu.t_ns[0]) / 1e9
    update: Callable[..., Any] = instance.update
    q_nb = np.empty((len(t_s), 4))
    for k, row in enumerate(rows):
        field = None if mag is None or row < 0 else mag.mag_b_ut[row]
        q_nb[k] = update(float(t_s[k]), imu.gyro_b_radps[k], imu.accel_b_mps2[k], field)
    return q_nb


def _check_quaternions(made: Any, n: int, target: str) -> Floats:
    """Return quaternions (N, 4) of unit length; raises :class:`BadRecording` for anything else."""
    try:
        q_nb = np.asarray(made, dtype=np.float64)
    except (TypeError, ValueError):
        raise BadRecording(f"{target}: returned {type(made).__name__}; return an Estimate or ({n}, 4)") from None
    if q_nb.shape != (n, 4):
        raise BadRecording(f"{target}: returned shape {q_nb.shape}; return an Estimate or quaternions ({n}, 4)")
    length = np.linalg.norm(q_nb, axis=1)
    wrong = np.flatnonzero(~(np.isfinite(length) & (length > 0)))
    if len(wrong):
        raise BadRecording(
            f"{target}: {len(wrong)} quaternions are zero or not finite, the first at sample {wrong[0]}; "
            "return one for every sample"
        )
    return np.asarray(q_nb / length[:, None], dtype=np.float64)


def _load_file(path: Path) -> Any:
    """Import a Python file by its path; its folder is searched for what it imports."""
    if not path.is_file():
        raise FileNotFoundError(path)
    folder = str(path.resolve().parent)
    if folder not in sys.path:
        sys.path.insert(0, folder)
    name = f"stillpoint_own_{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def _describe(error: BaseException) -> str:
    """Return the exception in one line, with the place where it was raised."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text} ({Path(last.filename).name}, line {last.lineno})"
