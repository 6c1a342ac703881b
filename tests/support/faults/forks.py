"""Run commands in forked processes, which have everything imported: a signal meets the work and not the imports.

The process of a command leads a session of its own, so that what it starts can be found after its end.
"""

import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from stillpoint.scripts.main import main

POLL_S = 0.0005
LONGEST_S = 120.0
TIMED_OUT = "timed out"


@dataclass(frozen=True)
class Ended:
    """What a command left behind: its exit code, -N for signal N, and what it printed."""

    code: int
    out: str
    err: str
    orphans: int  # processes that it started and that outlived it by ORPHANS_S

    @property
    def last_line(self) -> str:
        """Return the last line of the standard error."""
        lines = [line for line in self.err.strip().splitlines() if line.strip()]
        return lines[-1] if lines else ""

    @property
    def is_one_line(self) -> bool:
        """Return whether the command ended with code 2 and a line for each input that says why.

        A batch says it below its table.
        """
        said = [line for line in self.err.splitlines() if line.startswith("stillpoint: ")]
        said += [line for line in self.out.splitlines() if line.startswith("not made")]
        return self.code == 2 and len(said) >= 1 and "Traceback" not in self.err


ORPHANS_S = 12.0  # a process that lost its parent first removes the file that it is writing


class Fork:
    """A command that runs in a forked process."""

    def __init__(
        self,
        words: Sequence[str],
        folder: Path,
        *,
        environment: Mapping[str, str] | None = None,
        prepare: Callable[[], object] = lambda: None,
        stdin: Path | None = None,
        stdout: int | None = None,
    ) -> None:
        self._said = folder / ".said"
        self._said.mkdir(exist_ok=True)
        for name in ("out", "err"):
            (self._said / name).write_bytes(b"")
        self._code: int | None = None
        sys.stdout.flush()
        self.pid = os.fork()
        if self.pid == 0:
            self._become(words, folder, environment or {}, prepare, stdin, stdout)

    def _become(
        self,
        words: Sequence[str],
        folder: Path,
        environment: Mapping[str, str],
        prepare: Callable[[], object],
        stdin: Path | None,
        stdout: int | None,
    ) -> None:
        code = 1
        try:
            os.setsid()
            os.chdir(folder)
            os.environ.update(environment)
            flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
            os.dup2(os.open(stdin or os.devnull, os.O_RDONLY), 0)
            os.dup2(os.open(self._said / "out", flags) if stdout is None else stdout, 1)
            os.dup2(os.open(self._said / "err", flags), 2)
            sys.stdin, sys.stdout, sys.stderr = (
                os.fdopen(0, closefd=False),
                os.fdopen(1, "w", closefd=False),
                os.fdopen(2, "w", buffering=1, closefd=False),
            )
            signal.signal(signal.SIGINT, signal.default_int_handler)
            prepare()
            main(words)
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
        except BaseException:
            traceback.print_exc()
        finally:
            try:
                sys.stdout.flush()
            finally:
                os._exit(code)

    def has_ended(self) -> bool:
        """Return whether the process has ended."""
        if self._code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._code = os.waitstatus_to_exitcode(status)
        return self._code is not None

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the process of the command alone."""
        if not self.has_ended():
            os.kill(self.pid, number)

    def wait(self, longest_s: float = LONGEST_S) -> Ended:
        """Wait for the end of the process and of what it started; kill what is still there after ``longest_s``."""
        end = time.monotonic() + longest_s
        while not self.has_ended() and time.monotonic() < end:
            time.sleep(POLL_S)
        timed_out = not self.has_ended()
        if timed_out:
            os.kill(self.pid, signal.SIGKILL)
            while not self.has_ended():
                time.sleep(POLL_S)
        end = time.monotonic() + ORPHANS_S
        while (left := _count_session(self.pid)) and time.monotonic() < end:
            time.sleep(0.02)
        if left:
            os.killpg(self.pid, signal.SIGKILL)
        out, err = ((self._said / name).read_text(errors="replace") for name in ("out", "err"))
        assert self._code is not None
        return Ended(self._code, out, f"{err}\n{TIMED_OUT}" if timed_out else err, left)


def _count_session(leader: int) -> int:
    """Return how many processes of a session run."""
    try:
        os.killpg(leader, 0)
    except OSError:
        return 0
    count = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        count += words[2] == str(leader) and words[0] != "Z"
    return count
