"""Small things to keep in an archive."""

from pathlib import Path

import numpy as np

from stillpoint.datasets import Estimate, Info, Recording, Reference, write
from stillpoint.datasets.mcap.store import sha256


def write_recording(path: Path, seed: int = 0, n: int = 400, licence: str = "CC BY 4.0", **info: str) -> Path:
    """A level sensor at rest at 100 Hz with a little noise, so that every seed gives another file."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(n) / 100
    gyro = rng.normal(scale=0.01, size=(n, 3))
    accel = rng.normal(scale=0.05, size=(n, 3)) + np.array([0, 0, 9.81])
    mag = rng.normal(scale=0.3, size=(n, 3)) + np.array([0, 20, -40])
    truth = np.tile([1.0, 0, 0, 0], (n, 1))
    kept = Recording.from_arrays(path.stem, t_s, gyro, accel, mag, truth, licence=licence, **info)
    write(path, Recording(kept.name, kept.imu, kept.mag, truth=kept.truth, info=Info(licence=licence, **info)))
    return path


def write_reference(path: Path, recording: Path, n: int = 400) -> Path:
    """A reference of the recording that says that the sensor was level."""
    write(
        path,
        Reference(
            t_ns=np.arange(n, dtype=np.int64) * 10_000_000,
            q_nb=np.tile([1.0, 0, 0, 0], (n, 1)),
            cov_b_rad2=np.tile(np.eye(3) * 1e-4, (n, 1, 1)),
            gyro_bias_b_radps=np.zeros((n, 3)),
            method="graph",
            name=recording.stem,
            made_from={recording.name: sha256(recording)},
        ),
    )
    return path


def write_estimate(path: Path, recording: Path, name: str = "ekf", n: int = 400) -> Path:
    """An estimate of the recording that says that the sensor was level."""
    level = np.tile([1.0, 0, 0, 0], (n, 1))
    t_ns = np.arange(n, dtype=np.int64) * 10_000_000
    made_from = {recording.name: sha256(recording)}
    write(path, Estimate(t_ns, name, q_nb=level, recording=recording.stem, made_from=made_from))
    return path


def write_family(folder: Path, name: str = "run", seed: int = 0, **info: str) -> list[Path]:
    """A recording, its reference and an estimate."""
    recording = write_recording(folder / f"{name}.mcap", seed, **info)
    reference = write_reference(folder / f"{name}.reference.mcap", recording)
    return [recording, reference, write_estimate(folder / f"{name}.ekf.estimate.mcap", recording)]
