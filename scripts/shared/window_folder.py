"""Solved windows of a long recording in a folder beside the reference that they become, for a run that is stopped."""

import shutil
from collections.abc import Iterator, MutableMapping
from pathlib import Path
from typing import TYPE_CHECKING

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.files.result_store import ResultStore

if TYPE_CHECKING:
    from stillpoint.smoother.attitude.long.kept_windows import PackedWindow

_SUFFIX = ".parts"


class WindowFolder(MutableMapping[str, "PackedWindow"]):
    """The windows of one run: NAME.parts/KEY beside the file NAME, with a file for each window.

    ``key`` is the hash of everything that decides the run. Windows of other keys are removed: what decided them has
    changed, and nobody will ask for them. Nothing is made before the first window is kept. Raises
    :class:`BadParameter` when the folder cannot be written.
    """

    def __init__(self, target: Path, key: str) -> None:
        """Open the folder of windows of this key, and delete those of other keys of the target."""
        whole = _name_folder(target)
        self._folder = whole / key[:16]
        self._store = ResultStore(self._folder)
        for other in whole.glob("*"):
            if other != self._folder:
                shutil.rmtree(other, ignore_errors=True)

    def __getitem__(self, name: str) -> "PackedWindow":
        """Return a kept window; raises ``KeyError`` where it is missing."""
        from stillpoint.smoother.attitude.long.kept_windows import PackedWindow

        found = self._store.get(name)
        if found is None:
            raise KeyError(name)
        return PackedWindow(found.facts, found.arrays)

    def __setitem__(self, name: str, window: "PackedWindow") -> None:
        self._store.put(name, window.facts, window.arrays)

    def __delitem__(self, name: str) -> None:
        (self._folder / f"{name}.npz").unlink()

    def __iter__(self) -> Iterator[str]:
        return (file.stem for file in sorted(self._folder.glob("*.npz")))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def count_windows(self) -> int:
        """Return how many windows the recording has, by a window that is kept; 0 where none is."""
        facts = (self._store.facts(name) for name in self)
        return next((int(one["windows"]) for one in facts if one is not None), 0)


def remove_windows(target: Path) -> None:
    """Remove all windows of a reference; raises :class:`BadParameter` when their folder cannot be changed."""
    whole = _name_folder(target)
    if whole.exists():
        try:
            shutil.rmtree(whole)
        except OSError as error:
            raise BadParameter(f"{whole}: cannot be removed ({error.strerror}); remove it by hand") from None


def _name_folder(target: Path) -> Path:
    return target.with_name(f"{target.name}{_SUFFIX}")
