"""Take away what a command needs: room on the disk, permissions, a home, its input, its reader, the time."""

import ctypes
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from forks import Ended, Fork
from kills import hash_estimate
from writers import BOTH, CSV, FILLED, HAND, LAB, list_debris, list_visible

from stillpoint.datasets import StillpointError, read

STARTS = 40
DENIED_CAPABILITIES = (1 << 1) | (1 << 2)  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH: with them root ignores permissions
DROP_FROM_BOUNDING_SET = 24
CAPABILITY_VERSION = 0x20080522
TEXT_WRITERS = (
    "simulate phone-1 --minutes 0.6 -o out",
    f"import csv ../inputs/log.csv -o out {CSV}",
    f"estimate {HAND} -e cf -o out --force",
    f"estimate {BOTH} -e cf -o out --force --jobs 2",
    f"export {HAND} -o out",
    f"report {HAND} -o out",
    f"plot {HAND} --kind errors -o out/errors.png",
    f"reference {HAND} --method redistribution -o out --force",
    f"info {HAND} --json out/facts.json",
    "export-c -e cf -o out",
)


@dataclass(frozen=True)
class Case:
    """One row of the page."""

    done: str
    wanted: str
    seen: str
    clean: bool
    examples: tuple[str, ...] = ()


def list_cases(scratch: Path, rng: random.Random) -> list[Callable[[], Case]]:
    """Return everything that is done to commands, as functions that do it; ``scratch/inputs`` holds the inputs."""
    place = Places(scratch)
    return [
        lambda: _interrupt_early(place, rng, signal.SIGINT),
        lambda: _interrupt_early(place, rng, signal.SIGTERM),
        lambda: _end_while_writing(place, rng, signal.SIGTERM, 1),
        lambda: _end_while_writing(place, rng, signal.SIGINT, 1),
        lambda: _end_while_writing(place, rng, signal.SIGTERM, 2),
        lambda: _end_while_writing(place, rng, signal.SIGINT, 2),
        lambda: _fill_disk(place),
        lambda: limit_size(place),
        lambda: forbid_writing(place),
        lambda: forbid_reading(place),
        lambda: _take_home(place),
        lambda: _write_twice(place),
        lambda: _replace_input(place, rng),
        lambda: _cut_input(place, rng),
        lambda: _turn_clock_back(place),
        lambda: stall_reader(place),
        lambda: _leave_reader(place),
        lambda: _fill_output(place),
    ]


class Places:
    """Gives each command an empty folder beside the inputs."""

    def __init__(self, scratch: Path) -> None:
        self.scratch, self.inputs, self._count = scratch, scratch / "inputs", 0

    def make(self) -> Path:
        """Return a new folder with a folder ``out`` in it."""
        self._count += 1
        folder = self.scratch / f"case{self._count}"
        shutil.rmtree(folder, ignore_errors=True)
        (folder / "out").mkdir(parents=True)
        return folder


def _run(words: str, folder: Path, prepare: Callable[[], object] = lambda: None, **options: object) -> Ended:
    return Fork(words.split(), folder, prepare=prepare, **options).wait()


def _judge(done: str, wanted: str, answers: Sequence[tuple[str, str]]) -> Case:
    """Make a row of what each command answered: "" where it did what is wanted."""
    wrong = [f"`stillpoint {words}`: {fault}" for words, fault in answers if fault]
    seen = f"{len(answers) - len(wrong)} of {len(answers)}"
    return Case(done, wanted, seen, not wrong, tuple(wrong[:5]))


def _interrupt_early(place: Places, rng: random.Random, number: signal.Signals) -> Case:
    """Start the installed command and signal it within its first second."""
    command = Path(sys.executable).with_name("stillpoint")
    folder = place.make()
    words = ("simulate phone-1 --minutes 0.6 -o out", f"info {HAND}", f"estimate {HAND} -e cf -o out", "stream -e cf")

    def start(k: int, after_s: float) -> tuple[str, str]:
        with subprocess.Popen(
            [command, *words[k % len(words)].split()],
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            time.sleep(after_s)
            process.send_signal(number)
            _, err = process.communicate(timeout=300)
        code = process.returncode
        if "Traceback" in err or "ignored" in err:
            return words[k % len(words)], f"after {after_s:.2f} s: {err.strip().splitlines()[-1]}{_find_origin(err)}"
        good = code in (-number, 128 + number) or code == 0
        return words[k % len(words)], "" if good else f"after {after_s:.2f} s: exit code {code}"

    with ThreadPoolExecutor(2) as pool:
        delays = [rng.uniform(0, 1) for _ in range(STARTS)]
        answers = list(pool.map(start, range(STARTS), delays))
    before = [fault for _, fault in answers if fault.endswith(BEFORE_US)]
    ours = [(words, "" if fault in before else fault) for words, fault in answers]
    case = _judge(
        f"{number.name} within the first second of the installed command, {STARTS} times",
        f"no traceback, exit code {128 + number}",
        ours,
    )
    if not before:
        return case
    seen = f"{case.seen}; {len(before)} before Python had read a line of stillpoint, with Python's own traceback"
    return Case(case.done, case.wanted, seen, case.clean, case.examples)


BEFORE_US = " (in the start of Python)"


def _find_origin(err: str) -> str:
    """Say whether a traceback was raised before the main module of the command ran."""
    return "" if re.search(r"scripts/main\.py|bin/stillpoint", err) else BEFORE_US


def _end_while_writing(place: Places, rng: random.Random, number: signal.Signals, jobs: int) -> Case:
    words = f"estimate {BOTH} -e cf,gyro -o out --force --jobs {jobs}"
    whole_s = _time(lambda: _run(words, place.make()))
    answers = []
    for _ in range(12):
        folder = place.make()
        fork = Fork(words.split(), folder)
        time.sleep(rng.uniform(0, whole_s))
        fork.send(number)
        ended = fork.wait()
        fault = f"exit code {ended.code}: {ended.last_line}" if ended.code not in (0, 128 + number) else ""
        fault = fault or ("a traceback" if "Traceback" in ended.err or "ignored" in ended.err else "")
        fault = fault or (f"{ended.orphans} processes stay" if ended.orphans else "")
        answers.append((words, fault or _name_broken(folder)))
    how = "in processes of their own (--jobs 2)" if jobs > 1 else "in one process"
    return _judge(
        f"{number.name} at random points of estimates of two recordings {how}",
        f"exit code {128 + number}, no part and no process stays",
        answers,
    )


def _time(run: Callable[[], object]) -> float:
    begun = time.monotonic()
    run()
    return time.monotonic() - begun


def _name_broken(folder: Path) -> str:
    """Return what is wrong with the files of a folder whose command ended by itself."""
    if debris := list_debris(folder):
        return f"leaves {debris[0]}"
    for name, path in list_visible(folder).items():
        if path.suffix == ".mcap":
            try:
                read(path)
            except StillpointError as error:
                return f"{name} is broken: {error}"
        elif not path.stat().st_size and path.name != "lock":  # of an archive
            return f"{name} is empty"
    return ""


def _name_refusal_fault(ended: Ended, folder: Path) -> str:
    """Return what is wrong with a command that had to end with one line of error."""
    if not ended.is_one_line:
        return f"exit code {ended.code}: {ended.last_line or 'silence'}"
    return _name_broken(folder)


def _fill_disk(place: Places) -> Case:
    """Write on a disk of 64 kB; only root can make one."""
    done, wanted = "the disk is full (a file system of 64 kB)", "one line, exit code 2, nothing broken, no part"
    answers = []
    for words in TEXT_WRITERS:
        folder = place.make()
        mounted = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder / "out")], capture_output=True, check=False
        )
        if mounted.returncode:
            return Case(done, wanted, "not done: a file system can be mounted by root alone", True)
        try:
            (folder / "out" / "taken").write_bytes(bytes(60_000))
            answers.append((words, _name_refusal_fault(_run(words, folder), folder)))
        finally:
            subprocess.run(["umount", str(folder / "out")], check=True)
    return _judge(done, wanted, answers)


def limit_size(place: Places) -> Case:
    """Let no file grow beyond 2 kB, as a quota does."""
    answers = []
    for words in TEXT_WRITERS:
        folder = place.make()
        environment = {"STILLPOINT_RESULTS": str(folder / "kept")}

        def limit() -> None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (300, 300))

        answers.append((words, _name_refusal_fault(_run(words, folder, limit, environment=environment), folder)))
    return _judge(
        "no file may grow beyond 300 bytes (RLIMIT_FSIZE)", "one line, exit code 2, nothing broken, no part", answers
    )


def _obey_permissions() -> None:
    """Give up root's right to ignore the permissions of files."""
    if os.getuid() != 0:
        return
    libc = ctypes.CDLL(None, use_errno=True)
    head, data = (ctypes.c_uint32 * 2)(CAPABILITY_VERSION, 0), (ctypes.c_uint32 * 6)()
    if libc.capget(head, data):
        raise OSError(ctypes.get_errno(), "capget")
    for capability in (1, 2):  # processes that are started by this one shall not get them again
        libc.prctl(DROP_FROM_BOUNDING_SET, capability, 0, 0, 0)
    for k in (0, 1):  # effective and permitted
        data[k] &= ~DENIED_CAPABILITIES
    if libc.capset(head, data):
        raise OSError(ctypes.get_errno(), "capset")


def forbid_writing(place: Places) -> Case:
    answers = []
    for words in TEXT_WRITERS:
        folder = place.make()
        (folder / "out").chmod(0o555)
        answers.append((words, _name_refusal_fault(_run(words, folder, _obey_permissions), folder)))
        (folder / "out").chmod(0o755)
    return _judge("the folder may not be written into", "one line, exit code 2", answers)


def forbid_reading(place: Places) -> Case:
    answers = []
    verbs = (
        "info",
        "doctor",
        "estimate -e cf -o out",
        "reference -o out",
        "export -o out",
        "report -o out",
        "recover -o out",
    )
    for verb in verbs:
        folder = place.make()
        shutil.copy(place.inputs / "hand.mcap", folder / "out" / "hand.mcap")
        (folder / "out" / "hand.mcap").chmod(0)
        ended = _run(f"{verb} out/hand.mcap", folder, _obey_permissions)
        (folder / "out" / "hand.mcap").chmod(0o644)
        answers.append((verb, _name_refusal_fault(ended, folder)))
    return _judge("the input may not be read", "one line, exit code 2", answers)


def _take_home(place: Places) -> Case:
    def forget() -> None:
        for name in ("HOME", "XDG_CACHE_HOME", "TMPDIR"):
            os.environ.pop(name, None)

    def mislead() -> None:
        forget()
        os.environ.update(HOME="/proc/nowhere", TMPDIR="/proc/nowhere")

    answers = []
    for prepare in (forget, mislead):
        for words in TEXT_WRITERS:
            folder = place.make()
            ended = _run(words, folder, prepare)
            fault = f"exit code {ended.code}: {ended.last_line}" if ended.code else ""
            answers.append((words, fault or _name_broken(folder)))
    return _judge("HOME and TMPDIR are not set, or name folders that cannot be", "the work is done", answers)


def _write_twice(place: Places) -> Case:
    answers = []
    for words in TEXT_WRITERS:
        first, second, alone = place.make(), place.make(), place.make()
        shared = words.replace("out", "../both")
        both = place.scratch / "both"
        both.mkdir()
        running = [Fork(shared.split(), folder) for folder in (first, second)]
        codes = [fork.wait().code for fork in running]
        _run(words, alone)
        made = {name: path.read_bytes() for name, path in list_visible(both).items()}
        names = list_visible(alone / "out").keys()
        fault = f"exit codes {codes}" if any(codes) else "" if made.keys() == names else f"files {sorted(made)}"
        answers.append((words, fault or _name_broken(both)))
        shutil.rmtree(both)
    return _judge("two processes write the same files at the same time", "both succeed, the files are whole", answers)


def _replace_input(place: Places, rng: random.Random) -> Case:
    """Rename another recording over the input during the work: the result must be that of one of them."""
    words, name = "estimate run.mcap -e cf -o out --force", "run.cf.estimate.mcap"
    results, whole_s = [], 0.0
    for source in ("hand", "hand2"):
        folder = place.make()
        shutil.copy(place.inputs / f"{source}.mcap", folder / "run.mcap")
        begun = time.monotonic()
        _run(words, folder)
        whole_s = time.monotonic() - begun
        found = sorted((folder / "out").glob("*.estimate.mcap"))
        results.append([hash_estimate(path) for path in found])
    answers = []
    for _ in range(12):
        folder = place.make()
        shutil.copy(place.inputs / "hand.mcap", folder / "run.mcap")
        shutil.copy(place.inputs / "hand2.mcap", folder / "other.mcap")
        fork = Fork(words.split(), folder)
        time.sleep(rng.uniform(0, whole_s))
        os.replace(folder / "other.mcap", folder / "run.mcap")
        ended = fork.wait()
        made = [hash_estimate(path) for path in sorted((folder / "out").glob("*.estimate.mcap"))]
        fault = "" if ended.code == 0 or ended.is_one_line else f"exit code {ended.code}: {ended.last_line}"
        if ended.code == 0 and made not in results:
            fault = f"{name} is of neither input"
        answers.append((words, fault or _name_broken(folder)))
    return _judge(
        "another recording is renamed over the input during the work",
        "a result that is of one of the two, or one line",
        answers,
    )


def _cut_input(place: Places, rng: random.Random) -> Case:
    """Cut the input in place during the work: a result, or one line of error."""
    words = "estimate run.mcap -e cf -o out --force"
    folder = place.make()
    shutil.copy(place.inputs / "hand.mcap", folder / "run.mcap")
    whole_s = _time(lambda: _run(words, folder))
    answers = []
    for _ in range(12):
        folder = place.make()
        shutil.copy(place.inputs / "hand.mcap", folder / "run.mcap")
        fork = Fork(words.split(), folder)
        time.sleep(rng.uniform(0, whole_s))
        os.truncate(folder / "run.mcap", 100_000)
        ended = fork.wait()
        fault = "" if ended.code == 0 or ended.is_one_line else f"exit code {ended.code}: {ended.last_line}"
        answers.append((words, fault or _name_broken(folder / "out")))
    return _judge(
        "the input is cut to 100 kB in place during the work", "a result or one line of error; no crash", answers
    )


def _turn_clock_back(place: Places) -> Case:
    """Let the clock go back an hour at every look."""

    def turn() -> None:
        start, looks = time.time(), Counter[str]()

        def tell() -> float:
            looks["all"] += 1
            return start - 3600.0 * looks["all"]

        time.time = tell
        time.time_ns = lambda: int(tell() * 1e9)

    answers = []
    for words in (*TEXT_WRITERS, *FILLED, f"archive verify {LAB}"):
        folder = place.scratch / "lab-clock" if "archive" in words else place.make()
        folder.mkdir(exist_ok=True)
        ended = _run(words, folder, turn)
        fault = f"exit code {ended.code}: {ended.last_line}" if ended.code else ""
        answers.append((words, fault or _name_broken(folder)))
    folder, words = place.make(), "stream -e ekf,cf"
    lines = (place.inputs / "samples.csv").read_text().splitlines()
    (folder / "back.csv").write_text("\n".join([*lines[:900], *lines[300:900]]) + "\n")
    ended = _run(words, folder, stdin=folder / "back.csv")
    count = ended.out.count("\n")
    fault = f"exit code {ended.code}, {count} lines" if ended.code or count != 2 * 1499 else ""
    answers.append((f"{words} (stamps that jump back)", fault))
    return _judge("the clock goes back an hour at every look; stamps jump back", "the work is done", answers)


def _open_full_pipe() -> tuple[int, int]:
    """Return the ends of a pipe that takes no more byte."""
    read_end, write_end = os.pipe()
    os.set_blocking(write_end, False)
    with suppress(BlockingIOError):
        while True:
            os.write(write_end, bytes(4096))
    os.set_blocking(write_end, True)
    return read_end, write_end


PRINTERS = (f"info {HAND} --json -", f"doctor {HAND} --json -", "stream -e cf", "score ../inputs/hand.cf.estimate.mcap")


def _start_on_full_pipe(place: Places, words: str) -> tuple[Fork, int]:
    read_end, write_end = _open_full_pipe()
    stdin = place.inputs / "samples.csv" if words.startswith("stream") else None
    fork = Fork(words.split(), place.make(), stdout=write_end, stdin=stdin, prepare=lambda: os.close(read_end))
    os.close(write_end)
    end = time.monotonic() + 20
    while time.monotonic() < end and not fork.has_ended() and not _is_in_pipe(fork.pid):
        time.sleep(0.02)
    return fork, read_end


def _is_in_pipe(pid: int) -> bool:
    """Return whether a process waits for room in a pipe."""
    try:
        call = Path(f"/proc/{pid}/syscall").read_text().split()
    except OSError:
        return False
    return call[:2] == ["1", "0x1"]  # write to descriptor 1, on x86-64; elsewhere the full wait is taken


def stall_reader(place: Places) -> Case:
    answers = []
    for words in PRINTERS:
        fork, read_end = _start_on_full_pipe(place, words)
        waited = not fork.has_ended()
        fork.send(signal.SIGTERM)
        ended = fork.wait(30)
        os.close(read_end)
        expected = 0 if words.startswith("stream") else 143
        good = waited and ended.code == expected and "Traceback" not in ended.err
        answers.append((words, "" if good else f"waited: {waited}; exit code {ended.code}: {ended.last_line}"))
    return _judge(
        "nobody reads the standard output, whose pipe is full; then SIGTERM",
        "it waits, then ends (143; stream, which saves its state, 0)",
        answers,
    )


def _leave_reader(place: Places) -> Case:
    answers = []
    for words in PRINTERS:
        fork, read_end = _start_on_full_pipe(place, words)
        os.close(read_end)
        ended = fork.wait(30)
        good = ended.code == 0 and "Traceback" not in ended.err
        answers.append((words, "" if good else f"exit code {ended.code}: {ended.last_line}"))
    return _judge("the reader of a full pipe goes away", "it ends at once, exit code 0, no traceback", answers)


def _fill_output(place: Places) -> Case:
    answers = []
    for words in PRINTERS:
        stdin = place.inputs / "samples.csv" if words.startswith("stream") else None
        full = os.open("/dev/full", os.O_WRONLY)
        ended = _run(words, place.make(), stdin=stdin, stdout=full)
        os.close(full)
        answers.append((words, "" if ended.is_one_line else f"exit code {ended.code}: {ended.last_line}"))
    return _judge("the standard output is /dev/full", "one line, exit code 2", answers)
