"""Results kept by the content of what they were made from, so that a stopped batch can be continued.

The key of a result is the hash of the verb, the names and SHA-256 of the files that decide it, the settings, and the
version of stillpoint with its code. A file that a verb writes carries the key in its record ``stillpoint-made``: the
file itself is what is kept. Results that are no file, and refusals, lie in a folder of results.
"""

import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, is_dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any, Generic

import cattrs
import numpy as np
from cyclopts import Parameter

from stillpoint.datasets.errors import BadFile, StillpointError
from stillpoint.datasets.files.remote import is_url
from stillpoint.datasets.files.result_store import ResultStore, get_product_version, hash_code, make_key
from stillpoint.datasets.mcap.facts import from_json, to_json
from stillpoint.datasets.mcap.store import read_origin, sha256
from stillpoint.scripts.shared.children import Item, Outcome, Result
from stillpoint.scripts.shared.flags import Workers
from stillpoint.scripts.shared.jobs import run_jobs
from stillpoint.scripts.shared.output import print_line

_FOLDER = "STILLPOINT_RESULTS"  # the variable that names the folder of results
_ROW = "row"  # of the record in a file that was made: the facts that the verb prints, as JSON
_PEERS = ("vqf", "ahrs", "imufusion", "riann")  # packages outside stillpoint whose code gives results
_SETTLED_NS = 2_000_000_000  # a file that was changed less long ago may change again within a tick of its time
_FEW = 64  # files whose records this process reads itself

_FORCE = "Compute everything again, also what an earlier run has computed from the same files with the same settings."
_RESULTS = (
    "Folder of kept results; by default STILLPOINT_RESULTS, else stillpoint/results in the user's folder of caches."
)


@Parameter(name="*")
@dataclass(frozen=True)
class Keeping:
    """The use that is made of earlier results."""

    force: Annotated[bool, Parameter(negative=(), help=_FORCE)] = False
    results: Annotated[Path | None, Parameter(help=_RESULTS)] = None


REUSE = Keeping()


@dataclass(frozen=True)
class Deciding:
    """Everything that decides a result beside the code, and the file that the work writes."""

    inputs: tuple[Path, ...]
    settings: Mapping[str, Any]  # plain JSON, or settings of stillpoint
    target: Path | None = None


@dataclass(frozen=True)
class Task(Generic[Item]):
    """One item to work on, and what a file that is made of it says about its origin."""

    item: Item
    origin: Mapping[str, str]
    stamps: Mapping[str, "_Stamp | None"] = field(default_factory=dict)  # of inputs, by name, when they were hashed

    def __str__(self) -> str:
        return str(self.item)

    def hash_input(self, path: Path) -> str:
        """Return the SHA-256 of an input after it was read.

        It is hashed once more only where it may have changed. Raises :class:`BadFile` when it is another one than when
        the work was planned.
        """
        planned = from_json(self.origin["inputs"]).get(path.name) if self.origin else None
        if planned is not None and (stamp := self.stamps.get(path.name)) is not None and _read_stamp(path) == stamp:
            return str(planned)
        digest = sha256(path)
        if planned not in (None, digest):
            raise BadFile(f"{path.name}: was replaced while it was worked on; run the command again")
        return digest

    def make_origin(self, row: Mapping[str, Any]) -> Mapping[str, str]:
        """Return the record of a file with the facts that the verb prints; empty where it has no key."""
        return {**self.origin, _ROW: to_json(row)} if self.origin else {}


def run_kept(
    function: Callable[[Task[Item]], Result],
    items: Sequence[Item],
    decide: Callable[[Item], Deciding],
    workers: Workers,
    keeping: Keeping,
    what: str,
    result: Any,
    *,
    here_up_to: int | None = None,
) -> list[Outcome[Result]]:
    """Return the outcome of each item: kept ones of earlier runs, all others by :func:`run_jobs`.

    Results are kept as they arrive, so that a run that is killed loses what is under way only. What was kept and what
    is to do is printed to stderr. Errors that follow from the inputs are kept too; those of files that cannot be read,
    of missing packages, of defects and of processes that died are not.

    Parameters
    ----------
    function
        Makes the result of a task; one that writes a file gives it ``task.make_origin(result)``.
    items, workers, what, here_up_to
        As for :func:`run_jobs`; ``what`` is the verb.
    decide
        Returns what decides the result of an item.
    keeping
        Whether earlier results are used, and where they are.
    result
        The type of a result: dataclasses, numbers, text, arrays and mappings of these.
    """
    plans = [decide(item) for item in items]
    store = _Store(_find_folder(keeping.results), result)
    paths = list(dict.fromkeys(path for plan in plans for path in plan.inputs))
    inputs = dict(zip(paths, _hash_files(paths, workers, what), strict=True))
    origins = _describe_origins(plans, inputs, what)
    outcomes: list[Outcome[Result] | None] = [None] * len(items)
    if not keeping.force:
        made = _read_targets(plans, origins, workers, what)
        outcomes = [store.find(*of_one) for of_one in zip(plans, origins, made, strict=True)]
    missing = [place for place, outcome in enumerate(outcomes) if outcome is None]
    _say(what, len(items), len(missing))
    stamps = [{path.name: inputs[path].stamp for path in plans[place].inputs} for place in missing]
    tasks = [Task(items[place], origins[place], stamp) for place, stamp in zip(missing, stamps, strict=True)]

    def keep(number: int, outcome: Outcome[Result]) -> None:
        place = missing[number]
        outcomes[place] = outcome
        store.keep(plans[place], origins[place], outcome)

    if tasks:
        run_jobs(function, tasks, workers, what, here_up_to=here_up_to, on_done=keep)
    return [outcome for outcome in outcomes if outcome is not None]


class _Store:
    """Results of one type as plain JSON in a folder."""

    def __init__(self, folder: Path | None, result: Any) -> None:
        """Open the store, or none; ``result`` is the type that its facts are read back as."""
        self._store = None if folder is None else ResultStore(folder)
        self._type = result
        self._converter = cattrs.Converter()
        self._converter.register_unstructure_hook_func(_is_array, lambda array: array.tolist())
        self._converter.register_structure_hook_func(_is_array, lambda value, _: np.array(value, np.float64))

    def find(self, plan: Deciding, origin: Mapping[str, str], made: Mapping[str, str]) -> Outcome[Any] | None:
        """Return the kept outcome of an item; None where there is none, or where its file is another one."""
        if not origin:
            return None
        same_file = made.get("key") == origin["key"]
        if same_file and _ROW in made:
            return Outcome(from_json(made[_ROW]), kept=True)
        facts = None if self._store is None else self._store.facts(origin["key"])
        if facts is None:
            return None
        if facts["error"] is not None:  # it names the files as they were called then
            same_names = facts["inputs"] == [str(path) for path in plan.inputs]
            return Outcome(error=facts["error"], refused=True, kept=True) if same_names else None
        if facts["value"] is None or (plan.target is not None and not same_file):
            return None
        try:
            return Outcome(self._converter.structure(facts["value"], self._type), kept=True)
        except (cattrs.BaseValidationError, KeyError, TypeError, ValueError):
            return None

    def keep(self, plan: Deciding, origin: Mapping[str, str], outcome: Outcome[Any]) -> None:
        """Keep a result that its file does not hold, or an error that follows from the input."""
        if not origin or self._store is None or (outcome.error is not None and not outcome.refused):
            return
        if outcome.error is None and plan.target is not None and self._type is dict:
            return  # the file has it all
        value = None if outcome.error is not None else self._converter.unstructure(outcome.value, self._type)
        facts = {"error": outcome.error, "inputs": [str(path) for path in plan.inputs], "value": value}
        try:
            self._store.put(origin["key"], facts)
        except StillpointError as error:
            self._store = None
            print_line(f"stillpoint: results are not kept for another run: {error} (--results DIR)", sys.stderr)


def _is_array(kind: Any) -> bool:
    return getattr(kind, "__origin__", None) is np.ndarray


def _find_folder(asked: Path | None) -> Path | None:
    """Return the folder of kept results, which need not exist; None for a user without a home."""
    if asked is not None:
        return asked
    named = os.environ.get(_FOLDER)
    if named:
        return Path(named)
    caches = os.environ.get("XDG_CACHE_HOME")
    if caches:
        return Path(caches) / "stillpoint" / "results"
    try:
        return Path.home() / ".cache" / "stillpoint" / "results"
    except RuntimeError:
        return None


def _describe_origins(
    plans: Sequence[Deciding], hashed: Mapping[Path, "_Hashed"], what: str
) -> list[Mapping[str, str]]:
    """Return the record of each result: its key and what the key was made of. Empty where an input cannot be read."""
    code, peers = hash_code(("scripts",))[:12], {name: _find_version(name) for name in _PEERS}
    origins: list[Mapping[str, str]] = []
    for plan in plans:
        inputs = [(path.name, hashed[path].digest) for path in plan.inputs]
        if any(digest is None for _, digest in inputs):
            origins.append({})
            continue
        settings = {name: asdict(one) if _is_settings(one) else one for name, one in plan.settings.items()}
        key = make_key(verb=what, inputs=inputs, settings=settings, code=code, peers=peers)
        record = {"verb": what, "key": key, "version": get_product_version()}
        origins.append({**record, "inputs": to_json(dict(inputs)), "settings": to_json(settings)})
    return origins


def _find_version(package: str) -> str | None:
    """Return the version of a package; None where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _is_settings(value: Any) -> bool:
    return is_dataclass(value) and not isinstance(value, type)


@dataclass(frozen=True)
class _Stamp:
    """Hold what the file system says about a file; it changes with the content and when another takes the name."""

    inode: int
    size: int
    modified_ns: int
    changed_ns: int


@dataclass(frozen=True)
class _Hashed:
    """The SHA-256 of an input, None where it cannot be read: the work on it will say why."""

    digest: str | None
    stamp: _Stamp | None  # before it was read; None where none can be had, or where it may not show the next change


def _hash_files(paths: Sequence[Path], workers: Workers, what: str) -> list[_Hashed]:
    """Return the SHA-256 of each file."""
    if workers.scheduler is not None:
        return [_Hashed(outcome.value, None) for outcome in run_jobs(sha256, paths, workers, f"{what}: hash")]
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # hashing lets other threads run
        return list(threads.map(_hash_file, paths))


def _hash_file(path: Path) -> _Hashed:
    """Return SHA-256 and stamp of a file; no stamp for one just written, which may change again under it."""
    stamp = _read_stamp(path)
    if stamp is not None and time.time_ns() - stamp.changed_ns < _SETTLED_NS:
        stamp = None
    try:
        return _Hashed(sha256(path), stamp)
    except StillpointError:
        return _Hashed(None, None)


def _read_stamp(path: Path) -> _Stamp | None:
    """Return the stamp of a local file, where the system tells when a file was changed."""
    if os.name != "posix" or is_url(path):
        return None
    try:
        found = path.stat()
    except OSError:
        return None
    return _Stamp(found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns)


def _read_targets(
    plans: Sequence[Deciding], origins: Sequence[Mapping[str, str]], workers: Workers, what: str
) -> list[Mapping[str, str]]:
    """Return what the files that are there already say about their origin; empty where there is none."""
    found: list[Mapping[str, str]] = [{} for _ in plans]
    targets = [
        (place, plan.target)
        for place, (plan, origin) in enumerate(zip(plans, origins, strict=True))
        if origin and plan.target is not None and plan.target.is_file()
    ]
    if targets:
        read = run_jobs(read_origin, [path for _, path in targets], workers, f"{what}: kept", here_up_to=_FEW)
        for (place, _), outcome in zip(targets, read, strict=True):
            found[place] = outcome.value or {}  # a damaged file is made again
    return found


def _say(what: str, all_: int, missing: int) -> None:
    """Print how much of a batch earlier runs have done; nothing where they have done nothing."""
    if missing == all_:
        return
    if missing == 0:
        which = "the result is" if all_ == 1 else f"all {all_} results are"
        print_line(f"{what}: {which} kept from an earlier run, nothing to compute (--force computes again)", sys.stderr)
        return
    print_line(f"{what}: {all_ - missing} of {all_} kept from an earlier run, {missing} to compute", sys.stderr)
