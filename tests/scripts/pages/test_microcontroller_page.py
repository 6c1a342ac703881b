"""The exported filters on an emulated Cortex-M4F."""

import re
from pathlib import Path

import numpy as np
import pytest
from c_filters import ATTITUDE_LOOP, SPIN_LOOP, compile_filter, run_attitude, run_spin

from stillpoint.datasets.spin import BENCH
from stillpoint.filters.c.export import EXPORTED, export_filter
from stillpoint.scripts.pages.cortex_m import list_missing_tools, run_on_cortex_m4
from stillpoint.scripts.pages.microcontroller_page import PAGE, make_logs

missing = list_missing_tools()


@pytest.mark.slow
@pytest.mark.skipif(bool(missing), reason=f"not installed: {', '.join(missing)}")
@pytest.mark.parametrize("name", EXPORTED)
def test_a_cortex_m4_ends_where_this_computer_ends_in_single_precision(name: str, tmp_path: Path) -> None:
    is_spin = name.startswith("roll")
    log = make_logs()["spin" if is_spin else "attitude"]
    made = export_filter(name, geometry=BENCH)
    there = run_on_cortex_m4(made, log, tmp_path)
    run = compile_filter(made, tmp_path, SPIN_LOOP if is_spin else ATTITUDE_LOOP, single=True)
    if is_spin:
        here = run_spin(run, log, np.float32)
        expected = np.hstack([here["rest_rad"][-1], here["rate_radps"][-1], here["variances"][-1]])
    else:
        here = run_attitude(run, log, np.float32)
        expected = np.hstack([here["q_nb"][-1], here["bias"][-1]])
    np.testing.assert_allclose(there.last, expected, rtol=1e-4, atol=1e-5)
    assert 0 < there.mean_instructions <= there.most_instructions
    row = rf"\| `{name}` \| \d+ \| {there.state_bytes} \|"  # code and stack vary with the version of the compiler
    assert re.search(row, PAGE.read_text(encoding="utf-8")), (
        "run python -m stillpoint.scripts.pages.microcontroller_page"
    )
