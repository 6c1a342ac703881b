"""Run the jobs of a study one after another, or by a function of the caller."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from stillpoint.datasets.errors import StillpointError


class Outcome(Protocol):
    """The outcome of a job: a value, or the one line that says why there is none."""

    @property
    def value(self) -> Any:
        """Return what the function returned."""

    @property
    def error(self) -> str | None:
        """None when it returned."""


class JobRunner(Protocol):
    """Runs a function over items and returns their outcomes in order: here, on a pool of processes, on a cluster."""

    def __call__(self, function: Callable[[Any], Any], items: Sequence[Any], what: str) -> Sequence[Outcome]:
        """Run all items; ``what`` names them for a progress bar."""


@dataclass(frozen=True)
class Done:
    """The outcome of a job that ran in this process."""

    value: Any = None
    error: str | None = None


def run_here(function: Callable[[Any], Any], items: Sequence[Any], what: str) -> list[Done]:
    """Run the items one after another in this process."""
    outcomes = []
    for item in items:
        try:
            outcomes.append(Done(function(item)))
        except StillpointError as error:
            outcomes.append(Done(error=str(error)))
    return outcomes
