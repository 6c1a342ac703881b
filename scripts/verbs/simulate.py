"""``stillpoint simulate``: make recordings whose truth is known by construction."""

from json import loads
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track

from stillpoint.datasets import write
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.recording import Recording, rate_hz
from stillpoint.datasets.simulate import simulate as make
from stillpoint.scripts.shared.flags import OutDir, Whole
from stillpoint.scripts.shared.inputs import make_output_dir
from stillpoint.scripts.shared.output import STDOUT, JsonFile, print_line, write_json


def simulate(
    kind: str,
    /,
    *,
    out: OutDir = Path(),
    seed: Whole = 0,
    seeds: Whole = 1,
    minutes: float | None = None,
    seconds: float | None = None,
    rate: float | None = None,
    sensor: str | None = None,
    json: JsonFile = None,
) -> None:
    """Make recordings whose truth is known by construction; the same options give the same bytes.

    Writes one file KIND-seedN.mcap per seed (spin: KIND-SENSOR-seedN.mcap) and prints one line for each.
    docs/simulation.md describes the models.

    Parameters
    ----------
    kind
        phone-1 (slid over a table), phone-2 (on a tripod), phone-3 (in the hand, violent): the experiments of Elmi
        Aziz and Mohseni Araste 2021; phone-3-shaken (in one place), phone-3-level (shaken to the sides): the third
        moved otherwise. spin-constant, spin-variable (a motor's shaft with two
        accelerometers), spin-flight (five on a projectile). auv-dolphin, auv-dolphin-calm (an underwater
        vehicle). hand-calm, hand-magnet, hand-vibration, hand-bias-steps, hand-translation (one disturbance each). car
        (a drive through a town). servo-bench (swung by +-90 deg).
    out
        Folder to write into; made when it is not there.
    seed
        Seed of the first recording.
    seeds
        How many recordings, with rising seeds.
    minutes
        Length of each; by default 2 for phone-1, 4 for the other phones, 0.5 for spin-constant and spin-flight, 1 for
        spin-variable, 15 for auv, 30 for servo-bench.
    seconds
        The same in seconds.
    rate
        Samples per second of gyro and accelerometer; by default 100, for spin 250, for auv 50.
    sensor
        A preset of the kind: "phone", for auv "auv", for servo-bench "mpu6050" (each the default of its kind), or
        "perfect" (without any error); for spin "white" (the default),
        "vibration", "vibration-f4", "glitch", "replica", "adxl345", "tilted", "horizontal", "perfect".
    json
        Also write what was made as JSON to this file; - is the standard output.
    """
    if seeds < 1:
        raise BadParameter(f"--seeds {seeds}: give 1 or more")
    if seconds is not None:
        if minutes is not None:
            raise BadParameter("--minutes, --seconds: are the same length twice; give one of them")
        minutes = seconds / 60
    rows = []
    numbers = range(seed, seed + seeds)
    for number in track(numbers, "simulate", disable=seeds == 1, transient=True, console=Console(stderr=True)):
        recording = make(kind, seed=number, minutes=minutes, rate_hz=rate, sensor=sensor)
        path = make_output_dir(out) / f"{recording.name}.mcap"
        write(path, recording)
        rows.append(_list_facts(path, recording))
        if json != STDOUT:
            print_line(_format_line(rows[-1]))
    write_json(json, rows)


def _list_facts(path: Path, recording: Recording) -> dict[str, Any]:
    """Return what was simulated for ``--json``."""
    return {
        "file": str(path),
        "minutes": recording.duration_s / 60,
        "rates_hz": {name: rate_hz(t_ns) for name, t_ns in recording.streams()},
        "rests": len(loads(recording.info.extra.get("rests_s", "[]"))),
        "notes": list(recording.info.notes),
    }


def _format_line(row: dict[str, Any]) -> str:
    """Return what was simulated in one line."""
    rates = ", ".join(f"{name} {rate:.1f} Hz" for name, rate in row["rates_hz"].items())
    rests = f", {row['rests']} rests" if row["rests"] else ""
    notes = "".join(f"; {note}" for note in row["notes"])
    return f"{row['file']}: {row['minutes']:.1f} min, {rates}{rests}{notes}"
