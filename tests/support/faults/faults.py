"""Kill every command that writes, take away what it needs, and write ``docs/faults.md`` about what was seen.

``python tests/support/faults/faults.py`` (``make faults``) makes at least 400 kills in under ten minutes on two cores.
The exit code is 1 when anything broken was seen. ``--kills 40 -o FILE`` makes a short run. ``--only leaderboard tune``
kills these commands alone, and adds the kills to those that the page has of them.
"""

import argparse
import multiprocessing
import random
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from kills import BROKEN, DEBRIS, LOST, ORPHAN, OTHER, Tally, Trials
from surroundings import Case, list_cases
from writers import WRITERS, make_inputs

import stillpoint.scoring.report.page
import stillpoint.scripts.verbs.archives.keep
import stillpoint.scripts.verbs.reference
import stillpoint.studies.leaderboard  # noqa: F401

PAGE = Path("docs/faults.md")
KILLS, LEAST_KILLS = 460, 400
LONGEST_S = 540.0  # then no further kill is made, so that the program ends within ten minutes
KILLS_END = 0.75  # of that time, so that the rest has its share
SEED = 16
COUNTS = 8  # numbers in a row

HEAD = """# Faults

This page shows what happens to files when a process is killed, a disk is full or an input changes. `make faults` does
all of it on small recordings and writes this page. Its exit code is 1 when a row is not clean.

stillpoint promises four things:

1. A file is there whole or not at all.
2. Results that were reported as done remain.
3. An error is one line, with exit code 2.
4. The next command that writes into a folder removes what a killed process left there.

## Killed while writing

Every command runs in a folder and is killed (SIGKILL). Three of four kills come up to 30 ms after it has made its
first, second, … new file, one of four at any time. In every second run the folder has the results of an earlier run.

| column | counts |
|---|---|
| hits | kills that left a part of a file |
| broken | files with their final name that are not whole |
| lost | files of the earlier run, or reported files, that are missing |
| debris | parts that are still there after the same command has run again |
| other | results that differ from those of an undisturbed run where two undisturbed runs agree; see below |
| stay | processes that outlive their parent |
| not flushed | files that an undisturbed run does not flush to the disk (fsync) in its own process |

Results are compared bit for bit. Estimates contain the time that they took, so only their samples are compared.
`leaderboard --force` and `tune --force` first delete the results of earlier runs, as their help says: a kill then costs
those too, and they do not count as lost.
"""

MIDDLE = """
## What else can go wrong

*Seen* is the number of runs with the wanted result.
"""

TAIL = """
## What is not done here

A power cut (files are flushed before they get their names, and folders after; no disk was switched off), file systems
other than this machine's, Windows, `fetch` (needs a network), `demo` and `experiment` (write with the same functions),
object stores, and clusters (`tests/scripts/shared/test_cluster.py` kills their workers).
"""


def run_trials(number: int, kills: int, scratch: Path, until: float, seed: int) -> Tally:
    """Kill one command ``kills`` times; stop at the time ``until``."""
    try:
        trials = Trials(WRITERS[number], scratch, f"writer{number}", random.Random(seed + number))
    except SystemExit as error:  # undisturbed, it does not succeed
        failed = Tally(WRITERS[number])
        failed.blame(OTHER, " ".join(str(error).split())[:300])
        return failed
    for k in range(kills):
        if time.monotonic() > until:
            break
        trials.kill(k)
    trials.clear()
    return trials.tally


def share_kills(total: int, numbers: Sequence[int]) -> list[int]:
    """Return how many kills each of these writers gets, at least one."""
    whole = sum(WRITERS[number].share for number in numbers)
    return [max(1, round(total * WRITERS[number].share / whole)) for number in numbers]


def kill_writers(
    scratch: Path, total: int, numbers: Sequence[int], longest_s: float = LONGEST_S, seed: int = SEED
) -> list[Tally]:
    """Kill these writers, on two cores. Each has its share of the time, so that the last ones get theirs too."""
    kills, begun = share_kills(total, numbers), time.monotonic()
    ends_s = [longest_s * KILLS_END * (k + 1) / len(kills) for k in range(len(kills))]
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("fork")) as pool:
        running = [
            pool.submit(run_trials, number, some, scratch, begun + end_s, seed)
            for number, some, end_s in zip(numbers, kills, ends_s, strict=True)
        ]
        return [one.result() for one in running]


def format_page(tallies: Sequence[Tally], cases: Sequence[Case]) -> str:
    """Return the page."""
    columns = ("command", "kills", "hits", BROKEN, LOST, DEBRIS, "other", "stay", "not flushed")
    lines = [HEAD, "| " + " | ".join(columns) + " |", "|---" + "|---:" * COUNTS + "|"]
    for tally in tallies:
        lines.append(f"| `{tally.writer.shown}` | " + " | ".join(map(str, _count(tally))) + " |")
    totals = [sum(column) for column in zip(*map(_count, tallies), strict=True)]
    lines += ["| **all** | " + " | ".join(f"**{number}**" for number in totals) + " |", MIDDLE]
    lines += ["| done | wanted | seen | |", "|---|---|---|---|"]
    lines += map(_format_case, cases)
    if examples := find_faults_of(tallies, cases):
        lines += ["\n## What was not as wanted\n", *(f"- {one}" for one in examples)]
    return "\n".join([*lines, TAIL])


def add_to_page(page: str, tallies: Sequence[Tally], cases: Sequence[Case] = ()) -> str:
    """Return a page with more kills of some commands, and rows of more cases behind those that it has."""
    lines = page.splitlines()
    total = next(k for k, line in enumerate(lines) if line.startswith("| **all** |"))
    for tally in tallies:
        own = f"| `{tally.writer.shown}` |"
        if not any(line.startswith(own) for line in lines):
            lines.insert(total, own + " 0 |" * COUNTS)
            total += 1
        at = next(k for k, line in enumerate(lines) if line.startswith(own))
        kept = list(map(int, lines[at].removeprefix(own).strip(" |").split("|")))
        summed = [old + new for old, new in zip(kept, _count(tally), strict=True)]
        lines[at] = f"{own} " + " | ".join(map(str, summed)) + " |"
    rows = [line.rpartition("` |")[2].strip(" |").split("|") for line in lines[:total] if line.startswith("| `")]
    sums = [sum(map(int, column)) for column in zip(*rows, strict=True)]
    lines[total] = "| **all** | " + " | ".join(f"**{number}**" for number in sums) + " |"
    end = max(k for k, line in enumerate(lines) if line.startswith("| "))
    lines[end + 1 : end + 1] = [_format_case(case) for case in cases]
    return "\n".join([*lines, ""])


def _count(tally: Tally) -> list[int]:
    """Return the numbers of a row: kills, hits, and what was found."""
    found = [tally.counts[what] for what in (BROKEN, LOST, DEBRIS, OTHER, ORPHAN)]
    return [tally.kills, tally.hits, *found, len(tally.unflushed)]


def _format_case(case: Case) -> str:
    return f"| {case.done} | {case.wanted} | {case.seen} | {'' if case.clean else 'not clean'} |"


def find_faults_of(tallies: Sequence[Tally], cases: Sequence[Case]) -> list[str]:
    """Return an example of everything that was not as wanted."""
    found = [example for tally in tallies for example in tally.examples]
    found += [
        f"`{tally.writer.shown}`: not flushed: {', '.join(tally.unflushed[:4])}" for tally in tallies if tally.unflushed
    ]
    return found + [example for case in cases for example in case.examples]


def find_faults(kills: int, page: Path, longest_s: float) -> int:
    """Do everything, write the page, and return the exit code."""
    with tempfile.TemporaryDirectory(prefix="stillpoint-faults-") as name:
        scratch = Path(name)
        make_inputs(scratch / "inputs")
        tallies = kill_writers(scratch, kills, range(len(WRITERS)), longest_s)
        for tally in tallies:
            print(f"{tally.kills:4d} kills, {dict(tally.counts) or 'clean'}: {tally.writer.shown}", flush=True)
        cases = []
        for run in list_cases(scratch, random.Random(SEED)):
            begun = time.monotonic()
            cases.append(run())
            print(f"{time.monotonic() - begun:6.1f} s  {cases[-1].seen}: {cases[-1].done}", flush=True)
    page.write_text(format_page(tallies, cases), encoding="utf-8")
    made = sum(tally.kills for tally in tallies)
    for example in find_faults_of(tallies, cases):
        print(example)
    clean = all(tally.clean for tally in tallies) and all(case.clean for case in cases)
    if too_few := made < min(LEAST_KILLS, kills * 0.8):
        print(f"{made} kills were made, too few: the machine is too slow or has other work")
    print(f"{made} kills; {page} is written")
    return 0 if clean and not too_few else 1


def kill_more(only: Sequence[str], kills: int, page: Path, longest_s: float) -> int:
    """Kill the commands that begin with one of some words, add what was seen to the page, and return the exit code."""
    numbers = [k for k, writer in enumerate(WRITERS) if writer.words.startswith(tuple(only))]
    with tempfile.TemporaryDirectory(prefix="stillpoint-faults-") as name:
        scratch = Path(name)
        make_inputs(scratch / "inputs")
        tallies = kill_writers(scratch, kills, numbers, longest_s / KILLS_END, seed=time.time_ns())
    page.write_text(add_to_page(page.read_text(encoding="utf-8"), tallies), encoding="utf-8")
    for line in [f"{tally.kills:4d} kills: {tally.writer.shown}" for tally in tallies] + find_faults_of(tallies, []):
        print(line)
    return 0 if all(tally.clean for tally in tallies) else 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=KILLS)
    parser.add_argument("--longest-s", type=float, default=LONGEST_S)
    parser.add_argument("--out", "-o", type=Path, default=PAGE)
    parser.add_argument("--only", nargs="+", help="commands to kill, by how they begin")
    given = parser.parse_args()
    if given.only:
        sys.exit(kill_more(given.only, given.kills, given.out, given.longest_s))
    sys.exit(find_faults(given.kills, given.out, given.longest_s))
