"""Make the estimates of a leaderboard, one job per recording and estimator, and keep them in the store.

Kept estimates hold attitude, covariance and gyro bias in single precision (7e-6 deg): a tenth of the size of an MCAP
file.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.calibration.apply import apply_calibration, load_calibration
from stillpoint.datasets.errors import BadFile, BadParameter, StillpointError
from stillpoint.datasets.files.result_store import Result, ResultStore, make_key
from stillpoint.datasets.mcap.store import read_recording, sha256
from stillpoint.datasets.recording import Floats, Recording
from stillpoint.datasets.trajectory import Estimate
from stillpoint.studies.leaderboard.board import Source
from stillpoint.studies.leaderboard.entrants import Entrant
from stillpoint.studies.leaderboard.files import find_file

_UPPER = np.triu_indices(3)
LEFT_OUT = "arbitrary: the magnetometer is not calibrated"  # as the diagnostics of an estimate say it
WARM_UP_S = 10.0  # longest start that is left out; acc-ma, the slowest with a fixed time, takes 7 s


@dataclass(frozen=True)
class EstimateJob:
    """One estimator over one recording with one kind of input."""

    source: Source
    entrant: Entrant
    calibration_file: Path | None  # None: samples as recorded
    key: str
    store: ResultStore

    def __str__(self) -> str:
        return f"{self.entrant.name} on {self.source.recording}"


def plan_estimate(source: Source, entrant: Entrant, calibration_file: Path | None, store: ResultStore) -> EstimateJob:
    """Return the job with the key of its result; raises :class:`StillpointError` for a file that is missing."""
    deciding: dict[str, Any] = {"what": "estimate", "input": source.sha256, "entrant": entrant.identity()}
    if entrant.kind == "file":
        deciding["file"] = sha256(find_file(Path(source.file), entrant.target))
    if calibration_file is not None:
        deciding["calibration"] = sha256(calibration_file)
    return EstimateJob(source, entrant, calibration_file, make_key(**deciding), store)


def make_estimate(job: EstimateJob) -> None:
    """Make one estimate and keep it, or the reason why there is none.

    Raises :class:`StillpointError`, which is not kept, for what does not follow from the data: a missing package or
    file, a failure in one's own code.
    """
    try:
        recording = read_recording(job.source.file)
        if job.calibration_file is not None:
            known = load_calibration(job.calibration_file)
            recording = apply_calibration(recording, known, job.source.sha256)
        made = job.entrant.estimate(recording, Path(job.source.file))
    except StillpointError as error:
        if job.entrant.kind != "table" or isinstance(error, BadParameter | BadFile):
            raise
        job.store.put(job.key, {"error": str(error)})
        return
    job.store.put(job.key, _make_facts(made), _make_arrays(made, recording))


def load_estimate(result: Result, recording: Recording, name: str) -> Estimate:
    """Return a kept estimate, which is ``ready`` :data:`WARM_UP_S` after each start at the latest."""
    arrays, facts = result.arrays, result.facts
    q_nb = arrays["q_nb"].astype(np.float64)
    cov = _unpack_covariance(arrays["cov_b_rad2"]) if "cov_b_rad2" in arrays else None
    t_ns = arrays["t_ns"] if "t_ns" in arrays else recording.require_imu().t_ns
    return Estimate(
        t_ns=t_ns,
        name=name,
        q_nb=q_nb / np.linalg.norm(q_nb, axis=1, keepdims=True),
        cov_b_rad2=cov,
        gyro_bias_b_radps=arrays["gyro_bias_b_radps"].astype(np.float64) if "gyro_bias_b_radps" in arrays else None,
        ready=_limit_warm_up(t_ns, arrays["ready"]) if "ready" in arrays else None,
        recording=recording.name,
        params=facts["params"],
        ns_per_sample=float("nan") if facts["ns_per_sample"] is None else facts["ns_per_sample"],
    )


def _make_facts(made: Estimate) -> dict[str, Any]:
    """Return the facts of an estimate that are kept as JSON."""
    heading = made.diagnostics.get("heading")
    finite = np.isfinite(made.ns_per_sample)
    return {
        "error": None,
        "params": dict(made.params),
        "ns_per_sample": made.ns_per_sample if finite else None,
        "magnetometer_left_out": "it is not calibrated" if heading == LEFT_OUT else None,
    }


def _make_arrays(made: Estimate, recording: Recording) -> Mapping[str, NDArray[Any]]:
    """Return the columns of an estimate that are kept, in single precision; covariances as upper triangles (N, 6)."""
    if made.q_nb is None:
        raise BadParameter(f"{made.name}: is an angle about one axis; a leaderboard compares attitudes")
    arrays: dict[str, NDArray[Any]] = {"q_nb": made.q_nb.astype(np.float32)}
    if not np.array_equal(made.t_ns, recording.require_imu().t_ns):
        arrays["t_ns"] = made.t_ns
    if made.cov_b_rad2 is not None:
        arrays["cov_b_rad2"] = made.cov_b_rad2[:, _UPPER[0], _UPPER[1]].astype(np.float32)
    if made.gyro_bias_b_radps is not None:
        arrays["gyro_bias_b_radps"] = made.gyro_bias_b_radps.astype(np.float32)
    if made.ready is not None and not made.ready.all():
        arrays["ready"] = made.ready
    return arrays


def _limit_warm_up(t_ns: NDArray[np.int64], ready: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return ``ready`` (N,), true also where a start has lasted :data:`WARM_UP_S`.

    All estimators are scored on the samples that they share. Without this limit one that calls itself ready after
    minutes would take these minutes from all others, or would be left out as the slowest of all.
    """
    begins = np.flatnonzero(~ready & np.concatenate([[True], ready[:-1]]))
    since = np.searchsorted(begins, np.arange(len(ready)), side="right") - 1
    started_ns = t_ns[begins[np.maximum(since, 0)]] if len(begins) else t_ns
    return np.asarray(ready | (t_ns - started_ns > WARM_UP_S * 1e9))


def _unpack_covariance(upper: NDArray[np.float32]) -> Floats:
    """Return covariances (N, 3, 3) from their upper triangles (N, 6)."""
    cov = np.empty((len(upper), 3, 3))
    cov[:, _UPPER[0], _UPPER[1]] = upper
    cov[:, _UPPER[1], _UPPER[0]] = upper
    return cov
