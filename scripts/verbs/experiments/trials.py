"""Options and the loop over trials that all experiments share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from cyclopts import Parameter

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.scripts.shared.flags import Jobs, OutDir, Whole, Workers
from stillpoint.scripts.shared.jobs import run_jobs
from stillpoint.scripts.shared.output import JsonFile

Job = TypeVar("Job")
Trial = TypeVar("Trial")


@Parameter(name="*")
@dataclass(frozen=True)
class Trials:
    """The options of every experiment.

    Parameters
    ----------
    trials
        How many trials of each kind, with rising seeds.
    seed
        Seed of the first one.
    out
        Folder to write into; made when it is not there.
    jobs
        Processes; by default one per core.
    json
        Also write every figure as JSON to this file; - is the standard output.
    """

    trials: Whole = 5
    seed: Whole = 0
    out: OutDir = Path()
    jobs: Jobs = None
    json: JsonFile = None

    @property
    def seeds(self) -> range:
        """Return the seeds of all trials. Raises :class:`BadParameter` where there is none."""
        if self.trials < 1 or self.seed < 0:
            raise BadParameter(f"--trials {self.trials} --seed {self.seed}: give 1 trial or more, and a seed from 0 on")
        return range(self.seed, self.seed + self.trials)

    @property
    def words(self) -> str:
        """Return the options as words of a command that gives the same trials."""
        return f"--trials {self.trials} --seed {self.seed}"

    def run(self, trial: Callable[[Job], Trial], work: Sequence[Job], what: str) -> list[Trial]:
        """Run every trial, in order. Raises the :class:`StillpointError` of the first that fails."""
        outcomes = run_jobs(trial, work, Workers(self.jobs), what)
        failed = next((outcome.error for outcome in outcomes if outcome.value is None), None)
        if failed is not None:
            raise StillpointError(failed)
        return [outcome.value for outcome in outcomes if outcome.value is not None]


FIVE = Trials()
