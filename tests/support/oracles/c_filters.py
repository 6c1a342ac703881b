"""Compile an exported filter with a loop over columns, and run it through ctypes."""

import ctypes
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from stillpoint.filters.c.export import CSource

FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-O2")
# A zero argument stands for a sample that is missing.
ATTITUDE_LOOP = """#include "{stem}.h"
#include <stddef.h>
void run(int n, const sp_real *dt, const sp_real *gyro, const sp_real *accel, const sp_real *mag,
         const unsigned char *has_accel, const unsigned char *has_mag, sp_real *q, sp_real *bias, sp_real *cov,
         unsigned char *ready);
void run(int n, const sp_real *dt, const sp_real *gyro, const sp_real *accel, const sp_real *mag,
         const unsigned char *has_accel, const unsigned char *has_mag, sp_real *q, sp_real *bias, sp_real *cov,
         unsigned char *ready)
{{
    {stem}_filter filter;
    {stem}_init(&filter);
    for (int k = 0; k < n; k++) {{
        {stem}_filter moved = filter; /* a filter may be copied */
        ready[k] = {stem}_update(&moved, dt[k], gyro + 3 * k, has_accel[k] ? accel + 3 * k : NULL,
            has_mag[k] ? mag + 3 * k : NULL, q + 4 * k, bias + 3 * k, cov + 9 * k);
        filter = moved;
    }}
}}
"""
SPIN_LOOP = """#include "{stem}.h"
#include <stddef.h>
void run(int n, const sp_real *dt, const sp_real *accel, const sp_real *square, const unsigned char *has_accel,
         const unsigned char *has_square, const int *direction, int *turns, sp_real *rest, sp_real *rate,
         sp_real *variances, unsigned char *ready);
void run(int n, const sp_real *dt, const sp_real *accel, const sp_real *square, const unsigned char *has_accel,
         const unsigned char *has_square, const int *direction, int *turns, sp_real *rest, sp_real *rate,
         sp_real *variances, unsigned char *ready)
{{
    {stem}_filter filter;
    {stem}_init(&filter);
    for (int k = 0; k < n; k++) {{
        ready[k] = {stem}_update(&filter, dt[k], has_accel[k] ? accel + k : NULL, has_square[k] ? square + k : NULL,
            direction[k], turns + k, rest + k, rate + k, variances + 3 * k);
    }}
}}
"""


def compile_filter(made: CSource, folder: Path, loop: str, single: bool = False, compiler: str = "gcc") -> Any:
    """Write, compile with all warnings as errors, and load a filter; return its function ``run``."""
    (folder / f"{made.stem}.h").write_text(made.header)
    (folder / f"{made.stem}.c").write_text(made.source)
    (folder / "loop.c").write_text(loop.format(stem=made.stem))
    library = folder / f"{made.stem}{'-single' if single else ''}.so"
    precision = ["-DSTILLPOINT_SINGLE"] if single else []
    sources = [str(folder / f"{made.stem}.c"), str(folder / "loop.c")]
    subprocess.run([compiler, *FLAGS, *precision, "-shared", "-fPIC", "-o", str(library), *sources, "-lm"], check=True)
    run: Any = ctypes.CDLL(str(library)).run
    run.restype = None
    return run


def address(column: Any) -> Any:
    """Return the address of a contiguous column."""
    assert column.flags["C_CONTIGUOUS"]
    return column.ctypes.data_as(ctypes.c_void_p)


def run_attitude(run: Any, log: Any, real: Any = np.float64) -> dict[str, Any]:
    """Return what a compiled filter of attitude makes of a log."""
    n = len(log.dt_s)
    out = {"q_nb": np.empty((n, 4), real), "bias": np.empty((n, 3), real), "cov": np.empty((n, 9), real)}
    ready = np.empty(n, np.uint8)
    columns = [np.ascontiguousarray(c, real) for c in (log.dt_s, log.gyro_b_radps, log.accel_b_mps2, log.mag_b_ut)]
    masks = [np.ascontiguousarray(c, np.uint8) for c in (log.has_accel, log.has_mag)]
    run(n, *map(address, [*columns, *masks, *out.values(), ready]))
    return out | {"ready": ready.astype(bool)}


def run_spin(run: Any, log: Any, real: Any = np.float64) -> dict[str, Any]:
    """Return what a compiled filter of a spin makes of a log."""
    n = len(log.dt_s)
    turns, ready = np.empty(n, np.intc), np.empty(n, np.uint8)
    out = {"rest_rad": np.empty(n, real), "rate_radps": np.empty(n, real), "variances": np.empty((n, 3), real)}
    columns = [np.ascontiguousarray(c, real) for c in (log.dt_s, log.accel_radps2, log.square_rad2ps2)]
    masks = [np.ascontiguousarray(c, np.uint8) for c in (log.has_accel, log.has_square)]
    direction = np.ascontiguousarray(log.direction, np.intc)
    run(n, *map(address, [*columns, *masks, direction, turns, *out.values(), ready]))
    return out | {"turns": turns, "ready": ready.astype(bool)}
