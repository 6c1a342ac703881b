"""Which estimators to run, with which settings: what ``estimate`` and ``stream`` take from the command line."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.settings import choose_settings
from stillpoint.filters.front.heading_source import Heading
from stillpoint.filters.front.sources import make_front
from stillpoint.filters.precision import Precision
from stillpoint.filters.table import ATTITUDES, SPINS, Peer, SpinEstimator, find_estimator
from stillpoint.scripts.shared.batch import parse_assignments
from stillpoint.scripts.shared.flags import split_names

EXAMPLE = "cf.omega0_radps=0.3"
_HEADING, _RANGE = "heading", "range"  # of --set, beside the estimators


@dataclass(frozen=True)
class Run:
    """One estimator as the command line asks for it; settings may still be text."""

    estimator: str
    params: dict[str, Any]
    precision: Precision
    heading: Heading
    heading_params: dict[str, Any]
    ranges: dict[str, Any]


def choose_runs(estimators: str, set_: Sequence[str] | None, precision: Precision, heading: Heading) -> list[Run]:
    """Return one run per estimator, checked before the first sample is read. Raises :class:`BadParameter`."""
    names = _parse_names(estimators)
    entries = {name: find_estimator(name) for name in names}
    peers = [name for name, entry in entries.items() if isinstance(entry, Peer)]
    if precision == "single" and peers:
        raise BadParameter(
            f"--precision single: is not for {', '.join(peers)}: other packages compute in a precision of their own; "
            "leave it out, or these"
        )
    spins = [name for name, entry in entries.items() if isinstance(entry, SpinEstimator)]
    if heading != "mag" and spins:
        raise BadParameter(
            f"--heading {heading}: {', '.join(spins)} follows a spin, which has no heading; leave it out"
        )
    settings = _parse_settings(set_, names)
    make_front(heading, settings[_HEADING], settings[_RANGE], None)
    for name, entry in entries.items():
        choose_settings(entry.params(), settings[name], name)
    return [Run(name, settings[name], precision, heading, settings[_HEADING], settings[_RANGE]) for name in names]


def _parse_names(estimators: str) -> list[str]:
    """Return the estimators that a word of the command line stands for."""
    if estimators in ("all", "roll"):
        return list(ATTITUDES if estimators == "all" else SPINS)
    return split_names(estimators)


def _parse_settings(set_: Sequence[str] | None, names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return settings by what they are of: an estimator, the source of the heading, the sensors' ranges."""
    settings: dict[str, dict[str, Any]] = {name: {} for name in (*names, _HEADING, _RANGE)}
    for path, value in parse_assignments(set_, EXAMPLE).items():
        owner, dot, name = path.partition(".")
        if not dot:
            raise BadParameter(f"--set {path}={value}: write ESTIMATOR.NAME=VALUE, for example {EXAMPLE}")
        if owner not in settings:
            raise BadParameter(f"--set {path}={value}: {owner} is not among the estimators {', '.join(names)}")
        settings[owner][name] = value
    return settings
