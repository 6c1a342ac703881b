"""Feed ``stillpoint stream`` at 1 kHz for a long time: it must lose nothing, not grow, and say its latency.

``python tests/support/faults/soak.py --minutes 60`` (``make soak``). The exit code is 1 when an estimate is missing or
out of order, when the memory grows by more than ``GROWTH_MB`` after the first tenth, or when the stream ends with an
error.
Latency is stated and not judged: it belongs to the machine.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

RATE_HZ = 1000
GROWTH_MB = 4.0
ESTIMATORS = ("ekf", "cf")
COMMAND = [sys.executable, "-c", "from stillpoint.scripts.main import main; main()", "stream"]
COMPILED_S = 900.0  # for the first estimate, where nothing is compiled and the machine has other work
ENDED_S = 120.0  # for the last ones


class Answers:
    """Counts the estimates that come back, and what is wrong with their order."""

    def __init__(self) -> None:
        self.count, self.wrong = 0, 0
        self.first = threading.Event()

    def read(self, lines) -> None:
        """Read all lines: each sample is answered by every estimator, in order."""
        for line in lines:
            number, place = divmod(self.count, len(ESTIMATORS))
            facts = json.loads(line)
            if facts["t_ns"] != number * 10**9 // RATE_HZ or facts["estimator"] != ESTIMATORS[place]:
                self.wrong += 1
            self.count += 1
            self.first.set()


def make_samples(count: int) -> list[str]:
    """Return the numbers of samples of a sensor that is turned to and fro; they are fed again and again."""
    rng, t_s = np.random.default_rng(0), np.arange(count) / RATE_HZ
    swing = np.sin(2 * np.pi * t_s / t_s[-1])
    gyro = swing[:, None] * np.array([0.5, -0.2, 0.3]) + rng.normal(scale=0.01, size=(count, 3))
    accel = rng.normal(scale=0.05, size=(count, 3)) + np.array([0.0, 0.0, 9.81])
    mag = rng.normal(scale=0.3, size=(count, 3)) + np.array([0.0, 20.0, -44.0])
    return [",".join(f"{value:.5f}" for value in row) for row in np.hstack([gyro, accel, mag])]


def read_rss_mb(pid: int) -> float:
    """Return the resident memory of a process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def soak(minutes: float) -> int:
    """Feed the stream and print what was seen; return the number of faults."""
    total, samples, answers = round(minutes * 60 * RATE_HZ), make_samples(10 * RATE_HZ), Answers()
    with tempfile.TemporaryDirectory() as folder:
        facts_file = Path(folder) / "facts.json"
        process = subprocess.Popen(
            [*COMMAND, "-e", ",".join(ESTIMATORS), "--json", str(facts_file)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert process.stdin is not None
        reader = threading.Thread(target=answers.read, args=(process.stdout,), daemon=True)
        reader.start()
        process.stdin.write("t_ns,gx,gy,gz,ax,ay,az,mx,my,mz\n")
        sent, memory_mb, begun = 0, [], time.monotonic()
        while sent < total and process.poll() is None:
            due = min(int((time.monotonic() - begun) * RATE_HZ) + 1, total) if sent else 1
            lines = [f"{k * 10**9 // RATE_HZ},{samples[k % len(samples)]}\n" for k in range(sent, due)]
            process.stdin.write("".join(lines))
            process.stdin.flush()
            if not sent:
                answers.first.wait(COMPILED_S)
                begun = time.monotonic()
            if due // RATE_HZ > sent // RATE_HZ:
                memory_mb.append(read_rss_mb(process.pid))
            sent = due
            time.sleep(1 / RATE_HZ)
        took_s = time.monotonic() - begun
        process.stdin.close()
        reader.join(ENDED_S)
        code = process.wait(ENDED_S)
        rows = json.loads(facts_file.read_text())["rows"] if facts_file.exists() else []
    settled = memory_mb[len(memory_mb) // 10 :]
    growth_mb = max(settled[-max(len(settled) // 10, 1) :], default=0.0) - min(settled, default=0.0)
    lost = total * len(ESTIMATORS) - answers.count
    print(f"{sent} samples in {took_s:.0f} s to {', '.join(ESTIMATORS)}: {lost} estimates lost, {answers.wrong} astray")
    print(f"memory: {max(memory_mb, default=0.0):.1f} MB at most, {growth_mb:+.1f} MB after the first tenth")
    if rows:
        line, update = rows[0]["line_to_line"], rows[0]["update"]
        print(
            f"latency of a sample, line to line: median {line['median_us']:.0f}, p99 {line['p99_us']:.0f}, "
            f"max {line['max_us']:.0f} us; of that the estimators: p99 {update['p99_us']:.0f} us"
        )
    faults = [
        *([f"exit code {code}"] if code else []),
        *([f"{lost} estimates are missing"] if lost else []),
        *([f"{answers.wrong} estimates are not those of their sample"] if answers.wrong else []),
        *([f"memory grew by {growth_mb:.1f} MB, more than {GROWTH_MB:g}"] if growth_mb > GROWTH_MB else []),
        *([] if rows and all(row["n_samples"] == total for row in rows) else ["the stream counted other samples"]),
    ]
    for fault in faults:
        print(f"soak: {fault}")
    return len(faults)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    sys.exit(1 if soak(parser.parse_args().minutes) else 0)
