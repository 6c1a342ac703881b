"""The Arduino sketch, compiled for this computer with the standard input and output as its serial line."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from stillpoint.datasets.simulate import simulate
from stillpoint.filters import Stream
from stillpoint.filters.c.export import export_filter

SKETCH = Path(__file__).parents[3] / "docs" / "examples" / "serial_ekf" / "serial_ekf.ino"
SERIAL = """#include <cstdio>
struct Line {
    int next = -2;
    void begin(long) {}
    int available() { if (next == -2) next = getchar(); return next >= 0; }
    int read() { int now = next; next = -2; return now; }
    void print(const char *text) { fputs(text, stdout); }
    void print(double value, int digits) { printf("%.*f", digits, value); }
} Serial;
void setup();
void loop();
#include "serial_ekf.ino"
int main() { setup(); loop(); return 0; }
"""


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++")
def test_the_sketch_gives_what_stream_gives(tmp_path: Path) -> None:
    """To the nine digits that it prints; broken lines, and those out of order, are left out."""
    made = export_filter("ekf")
    for name, text in (("ekf.h", made.header), ("ekf.c", made.source), ("main.cpp", SERIAL)):
        (tmp_path / name).write_text(text)
    shutil.copy(SKETCH, tmp_path)
    for words in (
        ("gcc", "-std=c99", "-O2", "-c", "ekf.c"),
        ("g++", "-Wall", "-Wextra", "-Werror", "-O2", "main.cpp", "ekf.o", "-o", "sketch"),
    ):
        subprocess.run(words, cwd=tmp_path, check=True)
    recording = simulate("phone-1", seed=5, minutes=0.6)
    imu, mag, stream = recording.require_imu(), recording.mag, Stream("ekf")
    at = {int(imu.t_ns[np.searchsorted(imu.t_ns, t)]): k for k, t in enumerate(mag.t_ns) if t <= imu.t_ns[-1]}
    lines, expected = ["no sample", '{"t_ns":1,"gx":null,"gy":0,"gz":0,"ax":0,"ay":0,"az":9.81}'], []
    for t_ns, gyro, accel in zip(imu.t_ns.tolist(), imu.gyro_b_radps.tolist(), imu.accel_b_mps2.tolist(), strict=True):
        field = mag.mag_b_ut[at[t_ns]].tolist() if t_ns in at else None
        sample = {"t_ns": t_ns} | dict(zip(("gx", "gy", "gz", "ax", "ay", "az"), gyro + accel, strict=True))
        sample |= dict(zip(("mx", "my", "mz"), field, strict=True)) if field else {}
        lines += [json.dumps(sample, separators=(",", ":"))]
        expected.append(stream.update(t_ns, gyro, accel, field))
    lines.append(lines[5])  # out of order
    done = subprocess.run([tmp_path / "sketch"], input="\n".join(lines) + "\n", capture_output=True, text=True)
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert [one["ready"] for one in found] == [one.ready for one in expected]
    np.testing.assert_allclose([one["q_nb"] for one in found], [one.q_nb for one in expected], atol=2e-9)
