"""Downloads of published datasets through pooch: whole files are kept, missing and damaged ones are fetched."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from stillpoint.datasets.errors import BadParameter, BadSource
from stillpoint.datasets.fetch.sources import Source
from stillpoint.datasets.files.atomic import write_atomically

if TYPE_CHECKING:
    from pooch import HTTPDownloader, Pooch

_SUMS = "SHA256SUMS"  # in the format of the command sha256sum
_RETRIES = 2  # of a file whose download broke off or was damaged
_TIMEOUT_S = 30.0


@dataclass(frozen=True)
class Fetched:
    """One file of a dataset on this machine."""

    path: Path
    downloaded: bool  # False: it was there already, whole
    first_seen: bool  # nothing to compare it with: stillpoint has no SHA-256 of it, and it came for the first time


def fetch_trials(
    source: Source,
    trials: Sequence[str],
    folder: Path,
    address: str | None = None,
    report: Callable[[Fetched], object] = lambda _: None,
) -> list[Fetched]:
    """Fetch the files of trials into ``folder`` under the paths of the authors' repository, and return them in order.

    A file that is there with the right SHA-256 is kept, any other is fetched again, so that a run that was stopped goes
    on with the first missing file. Where stillpoint has no SHA-256 of a file, that of the first download is written to
    ``SHA256SUMS`` in the folder and holds from then on.

    Parameters
    ----------
    source, trials
        The dataset, and names of its trials.
    folder
        Made when it is not there.
    address
        Another server with the same paths, instead of that of the authors.
    report
        Called after each file.

    Raises
    ------
    BadParameter
        The address is no http(s) URL, or the folder cannot be written.
    BadSource
        A file cannot be fetched, or what came has another SHA-256.
    """
    import pooch  # here: it is slow to import, and reading the table of datasets does not need it

    pooch.get_logger().setLevel(logging.WARNING)
    base = (address or source.address).rstrip("/") + "/"
    if not base.startswith(("http://", "https://")):
        raise BadParameter(f"{base}: is not an address of a server; begin it with http:// or https://")
    paths = list(dict.fromkeys((*source.shared, *(path for trial in trials for path in source.files(trial)))))
    pinned = read_pinned_sums(source)
    known = _read_sums(folder / _SUMS) | pinned
    store = pooch.create(
        path=folder,
        base_url=base,
        registry={path: _name_algorithm(known.get(path)) for path in paths},
        retry_if_failed=_RETRIES,
    )
    downloader = pooch.HTTPDownloader(timeout=_TIMEOUT_S)
    all_fetched = []
    for path in paths:
        target = folder / path
        there = target.is_file() and known.get(path) == _find_sum(target)
        _fetch_file(store, path, downloader, base)
        first_seen = path not in known
        if first_seen:
            known[path] = _find_sum(target)
            own = {each: value for each, value in known.items() if each not in pinned}
            _write_sums(folder / _SUMS, own)
        all_fetched.append(Fetched(target, not there, first_seen))
        report(all_fetched[-1])
    return all_fetched


def read_pinned_sums(source: Source) -> dict[str, str]:
    """Return path and SHA-256 of the files of a dataset that stillpoint was developed with."""
    text = resources.files("stillpoint.datasets.fetch").joinpath(_SUMS).read_text(encoding="utf-8")
    all_sums = _parse_sums(text)
    prefix = f"{source.name}/"
    return {path.removeprefix(prefix): value for path, value in all_sums.items() if path.startswith(prefix)}


def _fetch_file(store: "Pooch", path: str, downloader: "HTTPDownloader", base: str) -> None:
    """Download one file, and check its SHA-256; raises :class:`BadSource` or :class:`BadParameter`."""
    from requests.exceptions import RequestException

    try:
        store.fetch(path, downloader=downloader)
    except RequestException as error:
        reason = f"HTTP {error.response.status_code}" if error.response is not None else type(error).__name__
        raise BadSource(
            f"{base}{path}: cannot be fetched ({reason}); run the command again; whole files are kept"
        ) from None
    except ValueError:  # of pooch, for a sum that differs
        raise BadSource(
            f"{base}{path}: the download had another SHA-256 than the known one, {1 + _RETRIES} times; "
            "try again later, or from another --mirror"
        ) from None
    except OSError as error:
        raise BadParameter(
            f"{error.filename or path}: cannot be written ({error.strerror}); free space or name another folder"
        ) from None


def _find_sum(path: Path) -> str:
    import pooch

    return str(pooch.file_hash(str(path), alg="sha256"))


def _name_algorithm(value: str | None) -> str | None:
    return None if value is None else f"sha256:{value}"


def _parse_sums(text: str) -> dict[str, str]:
    """Return the SHA-256 by path from lines as ``sha256sum`` writes them."""
    pairs = (line.split("  ", 1) for line in text.splitlines() if "  " in line)
    return {path: value for value, path in pairs}


def _read_sums(path: Path) -> dict[str, str]:
    return _parse_sums(path.read_text(encoding="utf-8")) if path.is_file() else {}


def _write_sums(path: Path, sums: dict[str, str]) -> None:
    text = "".join(f"{value}  {name}\n" for name, value in sorted(sums.items()))
    with write_atomically(path) as file:
        file.write(text.encode())
