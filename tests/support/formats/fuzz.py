"""Damage small valid inputs of every kind and read them: each must give a recording or one line of error.

``python tests/support/formats/fuzz.py --minutes 10`` (``make fuzz``), or ``--count 3000``. An input fails when it ends
in an exception that is no error of stillpoint, in an error of more than one line, in the death of the process, after
more than 10 s, or with more than 512 MB. Failing inputs are kept in ``build/fuzz``.
"""

import argparse
import multiprocessing as mp
import random
import shutil
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections import Counter, defaultdict
from multiprocessing.connection import Connection
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from fuzz_seeds import Seed, list_seeds

from stillpoint.datasets import StillpointError, read, write
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.importers.trajectories import read_poses

LONGEST_S = 10.0
LARGEST_BYTES = 512 << 20
LONGEST_MESSAGE = 1000  # characters; names of files are part of it
KEPT = Path("build/fuzz")
BY_BOUNDARY = " [unforeseen at "  # marks a message that the boundary made of an exception in our own code

INTERESTING = (
    b"\0",
    b"\xff",
    b"\x7f",
    b"\x80",
    b"\xff" * 4,
    b"\xff" * 8,
    b"\0" * 8,
    b"\0\0\0\x80",
    b"\xff\xff\xff\x7f",
)
CELLS = (
    *("", "nan", "inf", "-inf", "1e999", "-1e308", "1e-999", "0", "-1", "1e9999999", "9" * 400, "0x10", "1_000", "١٢"),
    *(",", ";", "\t", "\n", "\r", '"', "'", "#", "\\", "\0", "\x1b[31m", "$\\frac{$", "é", "\ufeff", "{", "[" * 3000),
    *("2025-02-30T00:00:00", "1700000000", "1700000000123456789", "17001e18000", "-0", "true", "None", "x" * 5000),
)


def damage_bytes(data: bytes, rng: random.Random) -> bytes:
    """Return bytes with one to four changes."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        at = rng.randrange(len(out)) if out else 0
        if rng.random() < 0.3:
            at = min(at, rng.randrange(min(len(out), 512) or 1))  # headers stand at the start
        size = rng.choice((1, 1, 2, 4, 8, 64, 1000))
        change = rng.randrange(7)
        if change == 0 and out:
            out[at] ^= 1 << rng.randrange(8)
        elif change == 1:
            word = rng.choice(INTERESTING)
            out[at : at + len(word)] = word
        elif change == 2:
            out[at : at + size] = rng.randbytes(size)
        elif change == 3:
            del out[at : at + size]
        elif change == 4:
            out[at:at] = out[at : at + size]
        elif change == 5:
            del out[at:]
        elif len(out) > size:
            begin = rng.randrange(len(out) - size)
            out[at : at + size] = out[begin : begin + size]
    return bytes(out)


def damage_text(data: bytes, rng: random.Random) -> bytes:
    """Return text with one to four cells or lines changed."""
    lines = data.decode("utf-8", "replace").split("\n")
    for _ in range(rng.choice((1, 1, 2, 4))):
        at = rng.randrange(len(lines)) if rng.random() < 0.7 else rng.randrange(min(3, len(lines)))
        change = rng.randrange(6)
        if change == 0:
            del lines[at:]
            lines = lines or [""]
        elif change == 1:
            lines.insert(at, rng.choice(lines))
        elif change == 2:
            lines[at] = rng.choice(CELLS)
        elif change == 3 and len(lines) > 1:
            del lines[at]
        else:
            separator = next((mark for mark in ",;\t " if mark in lines[at]), ",")
            cells = lines[at].split(separator)
            cells[rng.randrange(len(cells))] = rng.choice(CELLS)
            lines[at] = separator.join(cells)
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def damage_zip(file: Path, rng: random.Random) -> None:
    """Damage the text of one member and pack it again, so that the zip itself is whole."""
    with zipfile.ZipFile(file) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice(list(members))
    members[name] = damage_text(members[name], rng)
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for each, data in members.items():
            archive.writestr(each, data)


def damage(seed: Seed, file: Path, rng: random.Random) -> None:
    """Damage a file in place."""
    if file.suffix == ".zip" and rng.random() < 0.5:
        damage_zip(file, rng)
        return
    data = file.read_bytes()
    as_text = seed.text and rng.random() < 0.8
    file.write_bytes(damage_text(data, rng) if as_text else damage_bytes(data, rng))


def read_input(seed: Seed, source: Path, out: Path) -> str:
    """Read a damaged input as the command line does; return "accepted" or the message."""
    try:
        if seed.kind == "mcap":
            read(source)
        elif seed.kind == "poses":
            read_poses(source, **seed.poses)
        else:
            for imported in IMPORTERS[seed.kind].read_all(source, seed.options):
                write(out / "x.mcap", imported.recording)
                for estimate in imported.estimates:
                    write(out / "x.estimate.mcap", estimate)
    except StillpointError as error:
        cause = error.__cause__
        if cause is None or isinstance(cause, StillpointError):
            return str(error)
        place = traceback.extract_tb(cause.__traceback__)[-1]
        ours = "/site-packages/" not in place.filename and "/lib/python" not in place.filename
        return str(error) + (f"{BY_BOUNDARY}{Path(place.filename).name}:{place.lineno}" if ours else "")
    return "accepted"


def _peak_bytes() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))


def work(connection: Connection, seeds: list[Seed]) -> None:
    """Read inputs until told to stop; each answer is (outcome, what, peak bytes)."""
    warnings.simplefilter("error", RuntimeWarning)  # a warning is a second line on the terminal
    with tempfile.TemporaryDirectory() as folder:
        while (order := connection.recv()) is not None:
            number, source = order
            Path("/proc/self/clear_refs").write_text("5")  # begin the peak of memory anew
            try:
                what, outcome = read_input(seeds[number], source, Path(folder)), "message"
            except BaseException:
                what, outcome = traceback.format_exc(), "traceback"
            connection.send((outcome, what, _peak_bytes()))


class Reader:
    """A process that reads inputs and is replaced when it dies or hangs."""

    def __init__(self, seeds: list[Seed]) -> None:
        self.seeds = seeds
        self._start()

    def _start(self) -> None:
        self.ours, theirs = mp.Pipe()
        self.process = mp.get_context("fork").Process(target=work, args=(theirs, self.seeds), daemon=True)
        self.process.start()
        theirs.close()

    def read(self, number: int, source: Path) -> tuple[str, str, int]:
        """Return (outcome, what, peak bytes) of one input."""
        self.ours.send((number, source))
        try:
            if self.ours.poll(LONGEST_S):
                return self.ours.recv()
            outcome = ("hang", f"no answer after {LONGEST_S:g} s", 0)
        except (EOFError, ConnectionError):
            outcome = ("death", f"the process died of signal {-(self.process.exitcode or 0)}", 0)
        self.process.kill()
        self.process.join()
        self._start()
        return outcome


def judge(outcome: str, what: str, peak: int) -> str:
    """Return why an input fails, or nothing."""
    if outcome != "message":
        return outcome
    if "\n" in what or len(what) > LONGEST_MESSAGE:
        return "message of several lines, or a long one"
    return "memory" if peak > LARGEST_BYTES else ""


def fuzz(count: int | None, minutes: float, number: int) -> int:
    """Read damaged inputs and print a table; return the number of failures."""
    rng, seeds = random.Random(number), list_seeds()
    tally: dict[str, Counter[str]] = defaultdict(Counter)
    unforeseen: Counter[str] = Counter()
    failures, done, largest, slowest, end = [], 0, 0, 0.0, time.monotonic() + 60 * minutes
    with tempfile.TemporaryDirectory() as scratch:
        made = []
        for k, seed in enumerate(seeds):
            whole = Path(scratch) / f"whole{k}"
            whole.mkdir()
            source, file = seed.make(whole)
            made.append((whole, source.relative_to(whole), file.relative_to(whole)))
        reader = Reader(seeds)
        for k, (whole, source, _) in enumerate(made):
            outcome, what, _ = reader.read(k, whole / source)
            if what != "accepted":
                raise SystemExit(f"the whole input of {seeds[k].name} is refused: {what}")
        while done < count if count is not None else time.monotonic() < end:
            k = done % len(seeds)
            whole, source, file = made[k]
            copy = Path(scratch) / "copy"
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(whole, copy)
            damage(seeds[k], copy / file, rng)
            begin = time.monotonic()
            outcome, what, peak = reader.read(k, copy / source)
            slowest, largest = max(slowest, time.monotonic() - begin), max(largest, peak)
            reason = judge(outcome, what, peak)
            tally[seeds[k].name][reason or ("accepted" if what == "accepted" else "refused")] += 1
            if BY_BOUNDARY in what:
                unforeseen[what.partition(BY_BOUNDARY)[2]] += 1
            if reason:
                kept = KEPT / f"{number}-{done}"
                shutil.rmtree(kept, ignore_errors=True)
                shutil.copytree(copy, kept)
                (kept / "why.txt").write_text(f"{seeds[k].name}: {reason}\n{what}\n")
                failures.append(f"{seeds[k].name}: {reason}: {what.strip().splitlines()[-1][:200]} (in {kept})")
            done += 1
    for name, counts in tally.items():
        print(f"{name:26} " + ", ".join(f"{count} {what}" for what, count in sorted(counts.items())))
    print(f"{done} inputs, {len(failures)} failures; slowest {slowest:.1f} s, peak memory {largest / 2**20:.0f} MB")
    if unforeseen:
        places = ", ".join(f"{place} ({times})" for place, times in unforeseen.most_common(20))
        print(f"refused by the boundary for an exception in our own code at: {places}")
    print("\n".join(failures[:40]))
    return len(failures)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--count", type=int)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10**6))
    given = parser.parse_args()
    print(f"seed {given.seed}")
    sys.exit(1 if fuzz(given.count, given.minutes, given.seed) else 0)
