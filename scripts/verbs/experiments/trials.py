"""Options and the loop over trials that all experiments share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

from cyclopts import Parameter

from stillpoint.datasets.errors import BadParameter, StillpointError
from stillpoint.scripts.shared.flags import Jobs, OutDir, Whole, Workers
from stillpoint.scripts.shared.inputs import find_recordings
from stillpoint.scripts.shared.jobs import run_jobs
from stillpoint.scripts.shared.output import JsonFile

Job = TypeVar("Job")
Trial = TypeVar("Trial")


_DEFAULT_TRIALS = 5
FIRST_ONLINE = 10  # seed: online trials are other ones than those offline


@Parameter(name="*")
@dataclass(frozen=True)
class Trials:
    """The options of every experiment.

    Parameters
    ----------
    trials
        How many simulated trials of each kind, with rising seeds; by default as many as the paper has, or five.
    seed
        Seed of the first one; by default 0.
    recording
        Your own recordings instead of simulated trials: MCAP files, folders or globs. The paper's protocol runs on
        them, with references made from them as benchmarks. docs/how-to/record-for-a-paper-table.md says how to record.
    out
        Folder to write into; made when it is not there.
    jobs
        Processes; by default one per core.
    json
        Also write every figure as JSON to this file; - is the standard output.
    """

    trials: Whole | None = None
    seed: Whole | None = None
    recording: Annotated[list[Path] | None, Parameter(consume_multiple=True, negative=(), json_list=False)] = None
    out: OutDir = Path()
    jobs: Jobs = None
    json: JsonFile = None

    @property
    def seeds(self) -> range:
        """Return the seeds of all simulated trials. Raises :class:`BadParameter` where there is none."""
        count, first = _DEFAULT_TRIALS if self.trials is None else self.trials, self.seed or 0
        if count < 1 or first < 0:
            raise BadParameter(f"--trials {count} --seed {first}: give 1 trial or more, and a seed from 0 on")
        return range(first, first + count)

    @property
    def files(self) -> list[Path]:
        """Return the recordings to use instead of simulated trials; there is none when they are to be simulated.

        Raises :class:`BadParameter` for options that only simulated trials have, and where there is no such file.
        """
        if self.recording is None:
            return []
        self.refuse(trials=self.trials, seed=self.seed)
        return find_recordings(self.recording)

    def refuse(self, **options: object) -> None:
        """Raise :class:`BadParameter` when recordings come with an option that only simulated trials have."""
        for name, value in options.items():
            if self.recording is not None and value is not None:
                raise BadParameter(f"--{name}: applies to simulated trials only; leave it out with --recording")

    @property
    def words(self) -> str:
        """Return the options as words of a command that gives the same trials."""
        if self.recording is not None:
            return f"--recording {' '.join(map(str, self.recording))}"
        return f"--trials {len(self.seeds)} --seed {self.seeds.start}"

    def run(self, trial: Callable[[Job], Trial], work: Sequence[Job], what: str) -> list[Trial]:
        """Run every trial, in order. Raises the :class:`StillpointError` of the first that fails."""
        outcomes = run_jobs(trial, work, Workers(self.jobs), what)
        failed = next((outcome.error for outcome in outcomes if outcome.value is None), None)
        if failed is not None:
            raise StillpointError(failed)
        return [outcome.value for outcome in outcomes if outcome.value is not None]


SIMULATED = Trials()
