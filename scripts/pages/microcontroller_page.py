"""Write the page on filters on a microcontroller: ``python -m stillpoint.scripts.pages.microcontroller_page``.

Writes docs/microcontroller.md. Needs gcc and the programs of :mod:`stillpoint.scripts.pages.cortex_m`.
"""

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.spin import BENCH
from stillpoint.filters.c.export import EXPORTED, export_filter
from stillpoint.filters.front.sources import find_sources, prepare_log
from stillpoint.filters.sample import Log
from stillpoint.filters.spin import front as spin_front
from stillpoint.filters.spin.noise import SpinParams, make_channels
from stillpoint.filters.spin.sample import SpinLog
from stillpoint.scripts.pages.cortex_m import FLAGS, OnTarget, run_on_cortex_m4
from stillpoint.scripts.program import run_program

PAGE = Path(__file__).parents[2] / "docs" / "microcontroller.md"
_SAMPLES = 1500
_HEAD = f"""# Filters on a microcontroller: what they need

Made by `python -m stillpoint.scripts.pages.microcontroller_page`. Single precision, `arm-none-eabi-gcc` with
`{" ".join(FLAGS)}`
for a Cortex-M4F, run in the emulator `qemu-system-arm` (machine `mps2-an386`) over {_SAMPLES}
samples of a simulated recording: `phone-1`, seed 3, for attitudes, and `spin-variable`, seed 1, for spins.

Code is the filter with its constants, without the C library's mathematical functions. Stack is the most that an
update used. Instructions are counted by the emulator, to 40; they are not cycles, of which divisions, roots and waits
for the flash take more.
[How to use the filters](how-to/run-a-filter-on-a-microcontroller.md).

What `export-c` does not write: the guard in front of every filter (`filters/front/guard.py`: samples that are
saturated, not a number, or out of order), the heading by satellites, and the step from accelerometers to angular
acceleration and squared rate in front of `roll-ekf` and `roll-aekf` (`filters/spin/front.py`). Ranges, gaps and
geometry differ from device to device, and most firmware tests its readings already. So a device gives the filter the
samples that passed; in double precision the bits are then those of `stream`.

| filter | code, bytes | state, bytes | stack, bytes | instructions per update, mean | most |
|---|---|---|---|---|---|
"""


def make_logs() -> dict[str, Log | SpinLog]:
    """Return the samples for attitudes and for spins."""
    phone = simulate("phone-1", seed=3, minutes=1)
    log, _ = prepare_log(phone.require_imu(), find_sources(phone, "mag", None, None), "double")
    spin = simulate("spin-variable", seed=1).spin
    assert spin is not None
    params = SpinParams()
    front_c = spin_front.coefficients(make_channels(params, spin.geometry), params, "double")
    _, spins = spin_front.filter_log(spin.t_ns, spin.accel_mps2, spin.gyro_radps, spin_front.start(), front_c)
    return {
        "attitude": Log._make(column[:_SAMPLES] for column in log),
        "spin": SpinLog._make(column[:_SAMPLES] for column in spins),
    }


def main(page: Path = PAGE) -> None:
    """Measure all filters and write the page."""
    page.write_text(_make_page(_measure_filters()), encoding="utf-8")


def _measure_filters() -> dict[str, OnTarget]:
    """Run every exported filter in the emulator."""
    logs, found = make_logs(), {}
    for name in EXPORTED:
        with TemporaryDirectory() as folder:
            log = logs["spin" if name.startswith("roll") else "attitude"]
            found[name] = run_on_cortex_m4(export_filter(name, geometry=BENCH), log, Path(folder))
    return found


def _make_page(found: Mapping[str, OnTarget]) -> str:
    """Return the text of the page."""
    rows = [
        f"| `{name}` | {one.code_bytes} | {one.state_bytes} | {one.stack_bytes} | {one.mean_instructions} "
        f"| {one.most_instructions} |\n"
        for name, one in found.items()
    ]
    return _HEAD + "".join(rows)


if __name__ == "__main__":
    run_program(main)
