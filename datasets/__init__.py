"""Define recordings and what is made from them: data types, files, importers, simulators.

The data types are :class:`~stillpoint.datasets.recording.Recording` with its streams, and
:class:`~stillpoint.datasets.trajectory.Reference` and :class:`~stillpoint.datasets.trajectory.Estimate`.
"""

from stillpoint.datasets.errors import (
    BadFile,
    BadParameter,
    BadRecording,
    BadSource,
    StillpointError,
    Unobservable,
)
from stillpoint.datasets.mcap.store import read, write
from stillpoint.datasets.recording import (
    Encoder,
    Gps,
    Imu,
    Info,
    Mag,
    Recording,
    Series,
    Spin,
    SpinGeometry,
    Truth,
)
from stillpoint.datasets.trajectory import BasePoseReturn, Calibration, Estimate, Reference, SpinReference

__all__ = [
    "BadFile",
    "BadParameter",
    "BadRecording",
    "BadSource",
    "BasePoseReturn",
    "Calibration",
    "Encoder",
    "Estimate",
    "Gps",
    "Imu",
    "Info",
    "Mag",
    "Recording",
    "Reference",
    "Series",
    "Spin",
    "SpinGeometry",
    "SpinReference",
    "StillpointError",
    "Truth",
    "Unobservable",
    "read",
    "write",
]
