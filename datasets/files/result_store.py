"""Results kept by the content of what they were made from, so that a stopped study can be continued.

A key is the hash of everything that decides a result: the SHA-256 of the input, the estimator with its parameters and
version, the alignment, and the version of stillpoint. Results are written whole or not at all.
"""

import hashlib
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.files.atomic import write_atomically

_FACTS = "facts"
_DECIDING = ("datasets", "filters", "smoother", "scoring", "studies")  # packages whose code decides a result


@dataclass(frozen=True, eq=False)
class Result:
    """The result kept under one key."""

    facts: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class ResultStore:
    """A folder of results; several processes may use it together."""

    folder: Path

    def get(self, key: str) -> Result | None:
        """Return the result of a key; None when it is missing or unreadable."""
        try:
            with np.load(self._locate(key), allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            return Result(json.loads(bytes(arrays.pop(_FACTS))), arrays)
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    def facts(self, key: str) -> Mapping[str, Any] | None:
        """Return the facts of a key without its arrays; None when it is missing or unreadable."""
        try:
            with np.load(self._locate(key), allow_pickle=False) as file:
                found: Mapping[str, Any] = json.loads(bytes(file[_FACTS]))
                return found
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    def put(self, key: str, facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]] | None = None) -> None:
        """Keep a result; raises :class:`BadParameter` when the folder cannot be written."""
        text = np.frombuffer(json.dumps(facts).encode(), dtype=np.uint8)
        place = self._locate(key)
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            with write_atomically(place) as file:
                np.savez(file, allow_pickle=False, **{_FACTS: text, **(arrays or {})})
        except OSError as error:
            raise BadParameter(f"{place.parent}: cannot be written ({error.strerror}); name another folder") from None

    def clear(self) -> None:
        """Delete all results; raises :class:`BadParameter` when the folder cannot be changed."""
        try:
            for file in self.folder.glob("*.npz"):
                file.unlink(missing_ok=True)
        except OSError as error:
            raise BadParameter(f"{self.folder}: cannot be changed ({error.strerror}); name another folder") from None

    def _locate(self, key: str) -> Path:
        return self.folder / f"{key}.npz"


def make_key(**deciding: Any) -> str:
    """Return the key of everything that decides a result; values must be plain JSON."""
    text = json.dumps({"product": get_product_version(), **deciding}, sort_keys=True, default=_to_plain)
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def get_product_version() -> str:
    """Return the version of stillpoint with a hash of the code that decides results."""
    return f"{version('stillpoint')}+{hash_code(_DECIDING)[:12]}"


@cache
def hash_code(packages: tuple[str, ...]) -> str:
    """Return the SHA-256 of the Python files of these packages of stillpoint."""
    digest = hashlib.sha256()
    for package in packages:
        found = find_spec(f"stillpoint.{package}")  # found, not imported: a worker may never need it itself
        for folder in found.submodule_search_locations or () if found is not None else ():
            for file in sorted(Path(folder).rglob("*.py")):
                digest.update(file.relative_to(folder).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


def _to_plain(value: Any) -> Any:
    """Return numpy scalars and arrays as plain JSON; raises ``TypeError`` for anything else."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be part of a key")
