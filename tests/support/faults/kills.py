"""Kill every command that writes at random points, most of them while it writes, and look at what is left.

After each kill every file that can be seen must be whole, and a file that was there before, or that was reported, must
be there. Then the same command runs again in the same folder, which must hold the files of an undisturbed run and
nothing else.
"""

import hashlib
import json
import os
import random
import shutil
import signal
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from forks import POLL_S, Ended, Fork
from writers import Writer, list_debris, list_visible

from stillpoint.datasets import StillpointError, read
from stillpoint.datasets.mcap.store import read_estimate

ATTEMPTS = 4  # for a kill that comes after the end of the command
AFTER_S = (0.0, 0.001, 0.005, 0.03)  # the longest waits after a new file was seen


@dataclass
class Tally:
    """What was seen of one command."""

    writer: Writer
    kills: int = 0
    hits: int = 0  # kills that left a part behind
    counts: Counter[str] = field(default_factory=Counter)
    examples: list[str] = field(default_factory=list)
    seconds: float = 0.0  # of an undisturbed run
    unflushed: list[str] = field(default_factory=list)

    def blame(self, what: str, example: str) -> None:
        """Count a fault and keep an example of it."""
        self.counts[what] += 1
        if self.counts[what] <= 3:
            self.examples.append(f"`{self.writer.shown}`: {what}: {example}")

    @property
    def clean(self) -> bool:
        """Return whether nothing was found."""
        return not self.counts and not self.unflushed


BROKEN, LOST, DEBRIS, OTHER, ORPHAN = "broken", "lost", "debris", "another result", "orphan"


class Trials:
    """One command in a folder of its own: what it leaves undisturbed, and what it leaves when it is killed."""

    def __init__(self, writer: Writer, scratch: Path, name: str, rng: random.Random) -> None:
        self.writer, self.rng, self.tally = writer, rng, Tally(writer)
        self._work, self._before, self._after = (scratch / f"{name}-{part}" for part in ("work", "before", "after"))
        self._before.mkdir()
        for words in writer.before:
            _require_success(words, self._run(words, self._before))
        shutil.copytree(self._before, self._after, symlinks=True)
        watch = _Flushes(self._after / ".flushes")
        begun, self._events = time.monotonic(), 0
        _make_rooms(self._after)
        seen = _list_names(self._after)
        fork = self._start(writer.words, self._after, watch)
        while not fork.has_ended():
            new = _list_names(self._after) - seen
            self._events += bool(new)
            seen |= new
            time.sleep(POLL_S)
        _require_success(writer.words, fork.wait())
        self.tally.seconds = time.monotonic() - begun
        self._expected = _hash_files(self._after)
        old = list_visible(self._before).keys() | {"lab/lock", "lab/catalogue.sqlite"}  # SQLite flushes by itself
        watched = "--jobs" not in writer.words  # otherwise processes that are not watched write
        self.tally.unflushed = [
            name for name in watch.find_unflushed() if name in self._expected.keys() - old and watched
        ]
        shutil.copytree(self._before, self._work, symlinks=True)
        _require_success(writer.words, self._run(writer.words, self._work))
        again = _hash_files(self._work)
        self._varying = {name for name, digest in self._expected.items() if again.get(name) != digest}

    def kill(self, number: int) -> None:
        """Kill the command once, at a random point, and judge what is left."""
        is_over_old = self.writer.repeats and number % 2 == 1
        for _ in range(ATTEMPTS):
            shutil.rmtree(self._work, ignore_errors=True)
            shutil.copytree(self._after if is_over_old else self._before, self._work, symlinks=True)
            if self._kill_once(number):
                self._judge(is_over_old)
                return

    def _kill_once(self, number: int) -> bool:
        """Run the command and kill it; return whether it was still running then."""
        _make_rooms(self._work)
        seen = _list_names(self._work)
        fork = self._start(self.writer.words, self._work)
        if number % 4 == 3:
            time.sleep(self.rng.uniform(0, self.tally.seconds))
        else:
            left = self.rng.randint(1, max(self._events, 1))
            while left and not fork.has_ended():
                new = _list_names(self._work) - seen
                left -= bool(new)
                seen |= new
                time.sleep(0 if left == 0 else POLL_S / 2)
            time.sleep(self.rng.uniform(0, self.rng.choice(AFTER_S)))
        running = not fork.has_ended()
        fork.send(signal.SIGKILL)
        self._killed = fork.wait()
        return running and self._killed.code == -signal.SIGKILL

    def _judge(self, is_over_old: bool) -> None:
        tally, work = self.tally, self._work
        tally.kills += 1
        tally.hits += bool(list_debris(work))
        if self._killed.orphans:
            tally.blame(ORPHAN, f"{self._killed.orphans} processes")
        left = list_visible(work)
        for name, path in left.items():
            if not self._is_whole(name, path):
                tally.blame(BROKEN, name)
        reported = "" if self.writer.is_archive else self._killed.out
        for name in self._expected:
            if name not in left and ((is_over_old and not self.writer.forgets) or name in reported):
                tally.blame(LOST, name)
        if self.writer.is_archive and self._killed.out.strip() and not self._expected.keys() <= left.keys():
            tally.blame(LOST, str(sorted(self._expected.keys() - left.keys())[:3]))
        if not self.writer.repeats and not self.writer.following and left:
            self._remove_result()
        self._run_again()

    def _remove_result(self) -> None:
        """Remove what the command refuses to write over: the result itself, as its user would."""
        words = self.writer.words.split()
        target = self._work / (words[words.index("-o") + 1] if "-o" in words else words[2])
        if target.is_dir():
            shutil.rmtree(target)
        else:
            target.unlink(missing_ok=True)

    def _run_again(self) -> None:
        ended = self._run(self.writer.following or self.writer.words, self._work)
        if ended.code:
            self.tally.blame(OTHER, f"exit code {ended.code}: {ended.last_line}")
            return
        found = list_visible(self._work)
        if found.keys() != self._expected.keys():
            self.tally.blame(OTHER, f"files {sorted(found.keys() ^ self._expected.keys())[:3]}")
        for name, path in found.items():
            if not self._is_whole(name, path):
                self.tally.blame(OTHER, name)
        if debris := list_debris(self._work):
            self.tally.blame(DEBRIS, str(debris[:3]))
        if self.writer.check:
            checked = self._run(self.writer.check, self._work)
            if checked.code:
                self.tally.blame(BROKEN, f"{self.writer.check}: {checked.last_line or checked.out[-200:]}")

    def _is_whole(self, name: str, path: Path) -> bool:
        if self.writer.is_archive and name.startswith("lab/") and not name.startswith("lab/objects/"):
            return True  # dated records and a catalogue, which `archive verify` judges
        if name not in self._varying and name in self._expected:
            return _hash_file(path) == self._expected[name]
        return _is_readable(path)

    def _start(self, words: str, folder: Path, watch: "_Flushes | None" = None) -> Fork:
        _make_rooms(folder)
        environment = {"XDG_CACHE_HOME": str(folder / "cache"), "TMPDIR": str(folder / "tmp")}
        stdin = folder / self.writer.stdin if self.writer.stdin else None
        prepare = watch.begin if watch is not None else _do_nothing
        return Fork(words.split(), folder, environment=environment, stdin=stdin, prepare=prepare)

    def _run(self, words: str, folder: Path) -> Ended:
        return self._start(words, folder).wait()

    def clear(self) -> None:
        """Remove the folders."""
        for folder in (self._work, self._before, self._after):
            shutil.rmtree(folder, ignore_errors=True)


class _Flushes:
    """Notes in a process which files it flushes to the disk, and under which names they then appear."""

    def __init__(self, log: Path) -> None:
        self.log = log

    def begin(self) -> None:
        """Watch this process from now on."""
        log = os.open(self.log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        fsync = os.fsync

        def note(handle: int) -> None:
            stat = os.fstat(handle)
            os.write(log, f"{stat.st_dev} {stat.st_ino}\n".encode())
            fsync(handle)

        os.fsync = note

    def find_unflushed(self) -> list[str]:
        """Return the files of the folder that this process never flushed."""
        flushed = set(self.log.read_text().splitlines()) if self.log.exists() else set()
        folder = self.log.parent
        return [
            name
            for name, path in list_visible(folder).items()
            if f"{path.stat().st_dev} {path.stat().st_ino}" not in flushed
        ]


def _make_rooms(folder: Path) -> None:
    """Make the folders that every command has beside its results."""
    for below in ("cache", "tmp", ".said"):
        (folder / below).mkdir(exist_ok=True)
    for name in ("out", "err"):
        (folder / ".said" / name).touch()


def _do_nothing() -> None:
    return


def _require_success(words: str, ended: Ended) -> None:
    if ended.code:
        raise SystemExit(f"undisturbed, stillpoint {words} ends with {ended.code}:\n{ended.err}{ended.out}")


def _list_names(folder: Path) -> set[str]:
    """Return everything below a folder, as fast as can be."""
    found: set[str] = set()
    waiting = [str(folder)]
    while waiting:
        try:
            with os.scandir(waiting.pop()) as entries:
                for entry in entries:
                    found.add(entry.path)
                    if entry.is_dir(follow_symlinks=False):
                        waiting.append(entry.path)
        except OSError:
            continue
    return found


def _hash_file(path: Path) -> str:
    """Return the hash of a file; of an estimate, which carries the time that it took, that of its samples."""
    if path.name.endswith(".estimate.mcap"):
        try:
            return hash_estimate(path)
        except StillpointError:
            return "unreadable"
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _hash_files(folder: Path) -> Mapping[str, str]:
    return {name: _hash_file(path) for name, path in list_visible(folder).items()}


def hash_estimate(path: Path) -> str:
    """Return the hash of the samples of an estimate and of what it was made from. Raises ``BadFile``."""
    made = read_estimate(path)
    attitude = b"" if made.q_nb is None else made.q_nb.tobytes()
    return hashlib.sha256(made.t_ns.tobytes() + attitude + repr(sorted(made.made_from.items())).encode()).hexdigest()


def _is_readable(path: Path) -> bool:
    """Return whether a file whose bytes differ from run to run has its beginning and its end."""
    try:
        data = path.read_bytes()
        if path.suffix == ".mcap":
            read(path)
        elif path.suffix == ".json":
            json.loads(data)
        elif path.suffix == ".html":
            return data.rstrip().endswith(b"</html>")
        elif path.suffix == ".npz":
            return data.startswith(b"PK") and b"PK\5\6" in data[-100:]
    except (OSError, ValueError, StillpointError):
        return False
    return True
