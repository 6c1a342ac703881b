"""Every command that writes, on small inputs, for the programs that kill it and that take away what it needs."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from forks import Fork

from stillpoint.datasets import Imu, Info, Recording, write
from stillpoint.datasets.mcap.store import read_recording
from stillpoint.datasets.simulate import simulate

CSV = "--time t:s --gyro gx,gy,gz:rad/s --accel ax,ay,az:m/s2"
HAND, BOTH = "../inputs/hand.mcap", "../inputs/hand.mcap ../inputs/hand2.mcap"


@dataclass(frozen=True)
class Writer:
    """A command that writes into the folder in which it runs."""

    words: str
    share: float = 1.0  # of the kills; commands that take seconds get fewer
    before: tuple[str, ...] = ()  # commands that must have run in the folder
    check: str = ""  # a command that finds nothing wrong afterwards
    stdin: str = ""
    is_archive: bool = False  # it has a catalogue, whose bytes differ from run to run
    repeats: bool = True  # it can be run again where it has run
    forgets: bool = False  # it first deletes the results of earlier runs, as its help says
    following: str = ""  # the next command in the folder, where it is another one

    @property
    def shown(self) -> str:
        """Return the command as the page shows it."""
        return f"stillpoint {self.words.replace('../inputs/', '')}"


LAB = "--archive lab"
MADE = ("archive init lab",)
FILLED = (*MADE, f"archive add {BOTH} {LAB} --set licence=CC0-1.0")
VERIFY = f"archive verify {LAB}"

WRITERS = (
    Writer("simulate phone-1 --minutes 0.6 --seeds 2 -o out --json made.json", 1.5),
    Writer("simulate spin-constant --seconds 4 -o out"),
    Writer(f"import csv ../inputs/log.csv -o out {CSV} --json made.json", 1.5),
    Writer(f"import csv ../inputs/log.csv -o out {CSV} --split 4s"),
    Writer("join ../inputs/parts -o out"),
    Writer(f"cut {HAND} --from 2 --to 20 -o out", 1.5),
    Writer("doctor ../inputs/wrong.mcap --apply -o out --force --json found.json"),
    Writer(f"reference {HAND} --method redistribution -o out --force --json made.json"),
    Writer(f"reference {HAND} -o out --force", 0.5),
    Writer(f"estimate {HAND} -e cf -o out --force", 1.5),
    Writer(f"estimate {BOTH} -e cf,gyro -o out --force --jobs 1"),
    Writer(f"estimate {BOTH} -e cf,gyro -o out --force --jobs 2", 0.4),
    Writer(f"reference {BOTH} --method redistribution -o out --force --jobs 2", 0.4),
    Writer(f"export {HAND} -o out", 1.5),
    Writer("export ../inputs/hand.cf.estimate.mcap --format tum -o out", 1.5),
    Writer("score ../inputs/hand.cf.estimate.mcap --force --json scores.json"),
    Writer("validate ../inputs/hand.mcap --method redistribution --force --json validated.json"),
    Writer(f"report {HAND} -o out", 0.5),
    Writer(f"plot {HAND} --kind errors -o errors.pdf", 0.7),
    Writer("allan ../inputs/rest.mcap -o allan.toml --plot allan.png --json allan.json", 0.7),
    Writer(f"leaderboard {BOTH} -e cf,gyro -o board --force --jobs 1 --paper paper", 0.4, forgets=True),
    Writer(f"tune {HAND} -e cf-fixed --param kp_per_s=0.1:2 --trials 3 -o tuned --force --jobs 1", 0.4, forgets=True),
    Writer("export-c -e cf -o out"),
    Writer("spin design -o out --json design.json", 0.7),
    Writer("recover ../inputs/damaged.mcap -o out --json saved.json"),
    Writer(f"info {BOTH} --json facts.json"),
    Writer("stream -e cf --save state.json --json counts.json", stdin="../inputs/samples.csv"),
    Writer("archive init lab", is_archive=True, repeats=False, check=VERIFY),
    Writer(
        f"archive add {BOTH} ../inputs/hand.cf.estimate.mcap {LAB}", 1.5, before=MADE, check=VERIFY, is_archive=True
    ),
    Writer(f"archive tag hand.mcap {LAB} --tag walk --set place=Zurich", before=FILLED, check=VERIFY, is_archive=True),
    Writer(
        f"archive remove hand2.mcap {LAB} --reason old",
        before=FILLED,
        check=VERIFY,
        is_archive=True,
        repeats=False,
        following=f"archive list {LAB}",
    ),
    Writer(f"archive rebuild {LAB}", before=FILLED, check=VERIFY, is_archive=True),
    Writer(f"archive export all {LAB} -o bundle --date 2026-01-01", before=FILLED, repeats=False, is_archive=True),
    Writer(f"archive export all {LAB} -o bundle.zip --date 2026-01-01", before=FILLED, repeats=False, is_archive=True),
    Writer(f"archive bundle hand.mcap {LAB} -o one.mcap", before=FILLED, is_archive=True),
)


def make_inputs(folder: Path) -> None:
    """Write the inputs of all writers into a new folder."""
    folder.mkdir()
    hand = simulate("phone-1", seed=1, minutes=0.6)
    write(folder / "hand.mcap", replace(hand, name="hand"))
    write(folder / "hand2.mcap", replace(simulate("phone-1", seed=2, minutes=0.6), name="hand2"))
    imu = hand.require_imu()
    wrong = replace(imu, gyro_b_radps=-imu.gyro_b_radps)  # a remedy of the doctor
    write(folder / "wrong.mcap", replace(hand, name="wrong", imu=wrong))
    draw, n = np.random.default_rng(5), 12_000
    still = Imu(
        np.arange(n, dtype=np.int64) * 10_000_000,
        draw.normal(scale=1e-2, size=(n, 3)),
        draw.normal(scale=5e-2, size=(n, 3)) + np.array([0.0, 0.0, 9.81]),
    )
    write(folder / "rest.mcap", Recording("rest", still, info=Info()))
    whole = (folder / "hand.mcap").read_bytes()
    (folder / "damaged.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    rows = np.column_stack([imu.t_ns / 1e9, imu.gyro_b_radps, imu.accel_b_mps2])
    lines = [",".join(map(repr, map(float, row))) for row in rows]
    (folder / "log.csv").write_text("t,gx,gy,gz,ax,ay,az\n" + "\n".join(lines) + "\n")
    (folder / "samples.csv").write_text("t_s,gx,gy,gz,ax,ay,az\n" + "\n".join(lines[:1500]) + "\n")
    for words in (
        "estimate hand.mcap -e cf,gyro",
        f"import csv log.csv -o parts {CSV} --split 10s",
    ):
        ended = Fork(words.split(), folder).wait()
        if ended.code:
            raise SystemExit(f"stillpoint {words}: exit code {ended.code}: {ended.err}")
    read_recording(folder / "hand.mcap")


def list_visible(folder: Path) -> dict[str, Path]:
    """Return the files that a user sees below a folder: no hidden ones, no caches, no journal of an archive."""
    found = {}
    for path in sorted(folder.rglob("*")):
        below = path.relative_to(folder)
        hidden = any(part.startswith(".") or part in ("cache", "tmp", "incoming") for part in below.parts)
        if path.is_file() and not path.is_symlink() and not hidden:
            found[below.as_posix()] = path
    return found


def list_debris(folder: Path) -> list[str]:
    """Return the parts, half copies and temporary files that nobody writes any more."""
    return [
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.name.endswith((".part", ".copy")) or path.parent.name in ("tmp", "incoming")
    ]
