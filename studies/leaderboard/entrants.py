"""The entrants of a leaderboard: estimators of the table, one's own in Python, and trajectories from files."""

import inspect
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, entry_points, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from stillpoint.datasets.errors import BadParameter, nearest
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.settings import choose_settings, list_names
from stillpoint.datasets.trajectory import Estimate
from stillpoint.filters import estimate
from stillpoint.filters.table import ATTITUDES, ESTIMATORS, SPINS, Peer
from stillpoint.studies.leaderboard.board import DEFAULTS
from stillpoint.studies.leaderboard.files import find_files, read_estimate_of
from stillpoint.studies.leaderboard.own import hash_own, load_own, run_own

_ENTRY_POINTS = "stillpoint.estimators"
_PEER_PACKAGES = {
    "vqf": "vqf",
    "offline-vqf": "vqf",
    "fusion": "imufusion",
    "riann": "riann",
}  # all others are of the package ahrs
_SLOW = ("madgwick", "mahony", "ahrs-ekf", "fusion")  # loops in Python: 20-500 µs per sample
_OWN, _UNKNOWN = "its own", "unknown"  # origins of parameters of one's own estimators, and of files
Kind = Literal["table", "own", "file"]
Own = Callable[..., Any] | type


@dataclass(frozen=True)
class Entrant:
    """One estimator with its parameters; it can be pickled unless it holds an object of a notebook."""

    name: str  # as tables show it
    kind: Kind
    target: str  # key of the table of estimators, FILE.py:NAME or MODULE:NAME, or the label of the files
    params: Mapping[str, Any] = field(default_factory=dict)  # those that differ from the defaults
    origin: str = DEFAULTS  # of the parameters; says what they were chosen or tuned on
    version: str = ""  # of the code
    slow: bool = False
    spelled: str = ""  # as the user wrote it, where that is not the target
    own: Own | None = None  # an object given from Python; None: load the target

    def estimate(self, recording: Recording, source: Path) -> Estimate:
        """Run over a recording, or read the file beside ``source``. Raises :class:`StillpointError`."""
        if self.kind == "file":
            return read_estimate_of(source, self.target, recording)
        if self.kind == "own":
            return run_own(self.own or load_own(self.target), self.target, self.name, recording)
        return replace(estimate(recording, self.target, self.params), name=self.name)

    @property
    def spelling(self) -> str:
        """Return what names it in a study."""
        return self.spelled or self.target

    def identity(self) -> dict[str, Any]:
        """Return everything that decides what the estimator computes, for the key of its results."""
        return {"kind": self.kind, "target": self.target, "params": dict(self.params), "version": self.version}


def find_entrants(
    wanted: Sequence[str | Own], labels: Sequence[str], params: Mapping[str, Mapping[str, Any]] | None = None
) -> list[Entrant]:
    """Return the entrants that the names and objects stand for, and one for each label of files beside recordings.

    Parameters
    ----------
    wanted
        Names of the table of estimators (``all`` for every one of attitude), ``NAME@FILE.toml`` with parameters,
        ``FILE.py:NAME``, ``MODULE:NAME``, names of installed entry points, labels of files, or Python objects.
    labels
        Labels of the files beside the recordings: ``mine`` of ``NAME.mine.tum``. Each becomes an entrant.
    params
        Parameters by estimator name.

    Raises
    ------
    BadParameter
        For a name that stands for nothing, and for a parameter that does not exist or is out of range.
    """
    given = dict(params or {})
    found: list[Entrant] = []
    for each in wanted:
        names = list(ATTITUDES) if each == "all" else [each]
        found += [_find_entrant(name, labels, given) for name in names]
    used = {entrant.target for entrant in found if entrant.kind == "file"}
    found += [_make_entrant_of_files(label) for label in labels if label not in used]
    names = [entrant.name for entrant in found]
    unknown = [name for name in given if name not in names]
    if unknown:
        raise BadParameter(f"--set {unknown[0]}: is not among the estimators {', '.join(names)}")
    return _make_names_distinct(found)


def _find_entrant(name: str | Own, labels: Sequence[str], params: Mapping[str, Mapping[str, Any]]) -> Entrant:
    """Return what a name stands for: an estimator of the table, an own one, or files beside the recordings."""
    if not isinstance(name, str):
        return _make_entrant_of_object(name)
    known, at, settings_file = name.partition("@")
    if known in ESTIMATORS:
        settings, origin = read_settings(Path(settings_file), known) if at else ({}, _name_defaults(known))
        shown = f"{known}@{Path(settings_file).stem}" if at else known
        if shown in params:
            settings, origin = {**settings, **params[shown]}, "set by the user"
        return replace(_make_entrant_of_table(shown, known, settings, origin), spelled=name)
    if ":" in name:
        return Entrant(name.rpartition(":")[2], "own", name, origin=_OWN, version=hash_own(name), slow=True)
    installed = entry_points(group=_ENTRY_POINTS, name=name)
    if installed:
        target = next(iter(installed)).value
        return Entrant(name, "own", target, origin=_OWN, version=hash_own(target), slow=True)
    if name in labels:
        return _make_entrant_of_files(name)
    if name == "device":
        raise BadParameter("device: no recording has its device's own orientation beside it (NAME.device.*)")
    raise BadParameter(
        f"no estimator {name!r}, and no file NAME.{name}.tum, .csv, .mcap or .bag beside a recording; write your own "
        f"estimator as FILE.py:NAME or MODULE:NAME; {nearest(name, [*ATTITUDES, *labels])}"
    )


def _name_defaults(known: str) -> str:
    """Say what the default parameters of an estimator of the table were chosen on, where it is not their paper's."""
    chosen_on = getattr(ESTIMATORS[known], "chosen_on", "")
    return f"{DEFAULTS}, chosen on {chosen_on}" if chosen_on else DEFAULTS


def _make_entrant_of_files(label: str) -> Entrant:
    return Entrant(label, "file", label, origin=_UNKNOWN)


def _make_entrant_of_table(shown: str, known: str, settings: Mapping[str, Any], origin: str) -> Entrant:
    """Return an estimator of the table with its settings; raises :class:`BadParameter` for a spin estimator."""
    if known in SPINS:
        raise BadParameter(f"{known}: follows a spin about one axis; a leaderboard compares attitudes")
    entry = ESTIMATORS[known]
    choose_settings(entry.params(), settings, known)
    code = ""
    if isinstance(entry, Peer):
        package = _PEER_PACKAGES.get(known, "ahrs")
        try:
            code = f"{package} {version(package)}"
        except PackageNotFoundError:
            code = f"{package} missing"  # the run says how to install it
    return Entrant(shown, "table", known, dict(settings), origin, code, known in _SLOW)


def _make_entrant_of_object(own: Own) -> Entrant:
    """Return the entrant of a function or class given from Python.

    Raises :class:`BadParameter` for an instance: its state would go from one recording to the next.
    """
    if hasattr(own, "update") and not isinstance(own, type):
        raise BadParameter(f"{type(own).__name__}: is an instance; give the class, which is called for each recording")
    name = getattr(own, "__name__", type(own).__name__)
    try:
        code = inspect.getsource(own)
    except (OSError, TypeError):
        code = ""
    module = getattr(own, "__module__", "")
    return Entrant(name, "own", f"{module}:{name}", origin=_OWN, version=code, slow=True, own=own)


def read_settings(path: Path, estimator: str) -> tuple[dict[str, Any], str]:
    """Return the parameters in a TOML file of ``stillpoint tune --save`` and what they were tuned on."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadParameter(f"{estimator}@{path}: cannot be read ({error.strerror}); name a TOML file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadParameter(f"{estimator}@{path}: is not TOML ({error}); stillpoint tune --save writes one") from None
    settings = content.get("params", {})
    if content.get("estimator", estimator) != estimator:
        raise BadParameter(f"{estimator}@{path}: holds parameters of {content['estimator']}; use them with that name")
    if not isinstance(settings, dict) or not settings:
        known = ", ".join(list_names(ESTIMATORS[estimator].params())) or "none"
        raise BadParameter(f"{estimator}@{path}: has no table [params]; the parameters of {estimator} are {known}")
    return settings, str(content.get("tuned_on", f"set in {path.name}"))


def _make_names_distinct(entrants: Sequence[Entrant]) -> list[Entrant]:
    """Drop repetitions; entrants that share a name are shown by their target."""
    once = list({(entrant.name, entrant.kind, entrant.target): entrant for entrant in entrants}.values())
    names = [entrant.name for entrant in once]
    return [
        replace(entrant, name=entrant.target) if names.count(entrant.name) > 1 and entrant.kind == "own" else entrant
        for entrant in once
    ]


def list_default_estimators() -> list[str]:
    """Return the estimators of a leaderboard that names none: all of attitude whose package is installed."""
    return [
        name
        for name in ATTITUDES
        if not isinstance(ESTIMATORS[name], Peer) or find_spec(_PEER_PACKAGES.get(name, "ahrs")) is not None
    ]


def find_labels(sources: Sequence[Path]) -> list[str]:
    """Return the labels of trajectory files beside the recordings, sorted; ``device`` last."""
    labels = {label for source in sources for label in find_files(source)}
    return sorted(labels, key=lambda label: (label == "device", label))
