"""Arrays of files: real numbers only, and no more memory than the file justifies."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from stillpoint.datasets.errors import BadSource
from stillpoint.datasets.files.limits import LARGEST_MEMBER, raise_limit
from stillpoint.datasets.recording import Floats


def read_array(dataset: Any, path: Path) -> Floats:
    """Return an HDF5 data set as float64; raises :class:`BadSource` for one that claims too much or is not real."""
    if not isinstance(dataset, h5py.Dataset):
        raise BadSource(f"{path}: {dataset.name} is not an array; download the file again")
    claimed = int(np.prod([float(n) for n in dataset.shape])) * 8
    if claimed > raise_limit(LARGEST_MEMBER):
        raise BadSource(f"{path}: {dataset.name} claims {claimed} bytes; give --large if this is right")
    return to_floats(dataset[()], f"{path}: {dataset.name}")


def to_floats(values: Any, where: str) -> Floats:
    """Return real numbers as float64; raises :class:`BadSource` for complex numbers, text and objects."""
    array = np.asarray(values)
    if array.dtype.kind not in "biuf":
        kind = "complex numbers" if array.dtype.kind == "c" else "no numbers"
        raise BadSource(f"{where}: holds {kind}; export real numbers")
    return np.ascontiguousarray(array, dtype=np.float64)
