"""Make a reference or an estimate of an archive again from its recording, and compare both."""

import random
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stillpoint.datasets.archive import Archive, Entry
from stillpoint.datasets.calibration.apply import apply_calibration, get_calibration, load_calibration
from stillpoint.datasets.calibration.device import SUFFIX as DEVICE_SUFFIX
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.mcap.store import read, read_recording, sha256
from stillpoint.datasets.recording import Floats, Recording
from stillpoint.datasets.trajectory import Estimate, Reference, SpinReference
from stillpoint.filters import estimate
from stillpoint.smoother import attitude_reference, reference

_KINDS = ("reference", "roll reference", "estimate")

Made = Reference | SpinReference | Estimate


@dataclass(frozen=True)
class RemakeJob:
    """A kept file and what it was made from."""

    kept: Path
    file_name: str
    sha256: str
    recording: Path
    calibration: Path | None
    version: str  # of the stillpoint that made it


@dataclass(frozen=True)
class Remade:
    """How far the two are apart."""

    difference_rad: float  # the largest; infinite where their times differ
    version: str  # of the stillpoint that made the kept one


def draw_jobs(archive: Archive, count: int | None, seed: int) -> tuple[list[RemakeJob], dict[str, str]]:
    """Draw references and estimates that can be made again (None: all of them), and say why others cannot.

    The second value maps file names to reasons.
    """
    jobs, reasons = [], {}
    for entry in archive.find(" or ".join(f"kind = '{kind}'" for kind in _KINDS)):
        job = _make_job(archive, entry)
        if isinstance(job, str):
            reasons[entry.file_name] = job
        else:
            jobs.append(job)
    if count is not None and count < len(jobs):
        jobs = sorted(random.Random(seed).sample(jobs, count), key=lambda job: job.file_name)
    return jobs, reasons


def _make_job(archive: Archive, entry: Entry) -> RemakeJob | str:
    """Return the job of one object, or why there is none."""
    kept = {name: archive.entry(parent) for name, parent in archive.parents(entry.sha256)}
    missing = [name for name, parent in kept.items() if parent is None or parent.removed]
    if missing:
        return f"{', '.join(missing)} is not in the archive"
    recordings = [parent for parent in kept.values() if parent is not None and parent.kind == "recording"]
    others = [parent for parent in kept.values() if parent is not None and parent.kind != "recording"]
    if len(recordings) != 1:
        return "it does not say which recording it was made from"
    if len(others) > 1 or any(
        parent.kind != "reference" and not parent.file_name.endswith(DEVICE_SUFFIX) for parent in others
    ):
        return f"it was made from {', '.join(parent.file_name for parent in others)} too, which is no calibration"
    return RemakeJob(
        kept=archive.find_path(entry),
        file_name=entry.file_name,
        sha256=entry.sha256,
        recording=archive.find_path(recordings[0]),
        calibration=archive.find_path(others[0]) if others else None,
        version=str(entry.columns.get("version") or "?"),
    )


def remake(job: RemakeJob) -> Remade:
    """Make the file again with the settings that it records, and compare.

    Raises :class:`~stillpoint.datasets.errors.StillpointError` where it cannot be made.
    """
    kept, recording = read(job.kept), read_recording(job.recording)
    if isinstance(kept, Estimate):
        made: Made = _remake_estimate(kept, recording, job)
    elif isinstance(kept, Reference | SpinReference):
        known = None if job.calibration is None else load_calibration(job.calibration).calibration
        made = reference(recording, kept.method, flatten(kept.params), known)
    else:
        raise BadParameter(f"{job.file_name}: is neither a reference nor an estimate; name one")
    return Remade(compute_largest_difference_rad(kept, made), job.version)


def _remake_estimate(kept: Estimate, recording: Recording, job: RemakeJob) -> Estimate:
    """Make an estimate again with the settings, precision, heading and calibration that the kept one states."""
    digest = sha256(job.recording)
    if job.calibration is not None:
        recording = apply_calibration(recording, load_calibration(job.calibration), digest)
    elif "calibrated_by" in kept.diagnostics:  # `estimate --calibration reference` made one and did not write it
        found = replace(attitude_reference(recording), made_from={job.recording.name: digest})
        recording = apply_calibration(recording, get_calibration(found), digest)
    asked: Mapping[str, Any] = kept.diagnostics.get("asked", {})
    return estimate(
        recording,
        kept.name,
        flatten(kept.params),
        "single" if kept.diagnostics.get("precision") == "single" else "double",
        asked.get("heading", "mag"),
        heading_params=asked.get("heading_params"),
        ranges=asked.get("ranges"),
    )


def flatten(params: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested settings as one mapping of dotted names, as :func:`choose_settings` takes them."""
    flat: dict[str, Any] = {}
    for name, value in params.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def compute_largest_difference_rad(kept: Made, made: Made) -> float:
    """Return the largest angle between two trajectories, in rad; infinite where their kinds or times differ."""
    if type(kept) is not type(made) or not np.array_equal(kept.t_ns, made.t_ns):
        return float("inf")
    found = [0.0]
    q_kept, q_made = getattr(kept, "q_nb", None), getattr(made, "q_nb", None)
    if q_kept is not None and q_made is not None:
        found.append(float(_compute_angles_rad(q_kept, q_made).max()))
    for name in ("angle_rad", "rate_radps"):
        one, other = getattr(kept, name, None), getattr(made, name, None)
        if (one is None) != (other is None):
            return float("inf")
        if one is not None:
            found.append(float(np.abs(one - other).max()))
    return max(found)


def _compute_angles_rad(q_a: Floats, q_b: Floats) -> Floats:
    """Return the angle (N,) between attitudes (N, 4)."""
    return np.asarray((rotation(q_a).inv() * rotation(q_b)).magnitude(), dtype=np.float64)
