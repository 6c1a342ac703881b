"""Run exported filters on a Cortex-M4F in the emulator qemu-system-arm, and measure code, stack and instructions."""

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillpoint.filters.c.export import CSource
from stillpoint.filters.sample import Log
from stillpoint.filters.spin.sample import SpinLog

_TOOLS = ("arm-none-eabi-gcc", "arm-none-eabi-size", "qemu-system-arm")
_CPU = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-Wdouble-promotion", "-O2", "-DSTILLPOINT_SINGLE")
_TIMEOUT_S = 120

_LAYOUT = """MEMORY { ram (rwx) : ORIGIN = 0, LENGTH = 4M }
ENTRY(reset)
SECTIONS {
    .text : { KEEP(*(.vectors)) *(.text* .rodata*) } > ram
    .data : { *(.data*) } > ram
    .bss : { *(.bss* COMMON) } > ram
    stack_bottom = ALIGN(8);
    stack_top = stack_bottom + 64K;
}
"""
# The emulator counts one instruction as 1 ns (-icount shift=0), and the system's timer runs at 25 MHz.
_START = """#include <stdint.h>
#include <stddef.h>
#include "{stem}.h"

extern uint32_t stack_bottom[], stack_top[];
void reset(void);
#define PAINT 0xA5A5A5A5u
#define TIMER ((volatile uint32_t *)0xE000E010)

static void call_host(int operation, const void *argument)
{{
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
}}

static void print_word(char kind, uint32_t word)
{{
    char text[11];
    text[0] = kind;
    for (int i = 0; i < 8; i++) {{
        text[1 + i] = "0123456789abcdef"[(word >> (28 - 4 * i)) & 15];
    }}
    text[9] = '\\n';
    text[10] = 0;
    call_host(4, text);
}}

static void print_real(float value)
{{
    union {{ float real; uint32_t word; }} both = {{value}};
    print_word('r', both.word);
}}

static void fault(void)
{{
    print_word('f', 0);
    call_host(0x18, (void *)0x20024);
    for (;;) {{
    }}
}}

__attribute__((section(".vectors"), used)) static void *const vectors[] = {{
    stack_top, reset, fault, fault, fault, fault, fault,
}};

{data}
static {stem}_filter filter;
static float out[8];

static char *top; /* of the stack, where an update begins */

__attribute__((noinline)) static void update(int k)
{{
    top = __builtin_frame_address(0);
{update}
}}

/* Paint the stack below, so that what an update has used shows afterwards. */
__attribute__((noinline)) static void paint_stack(void)
{{
    uint32_t *here;
    __asm__ volatile("mov %0, sp" : "=r"(here));
    for (uint32_t *word = stack_bottom; word < here - 16; word++) {{
        *word = PAINT;
    }}
}}

__attribute__((noinline)) int main(void);
int main(void)
{{
    uint32_t total = 0, most = 0;
    uint32_t *low = stack_bottom;
    {stem}_init(&filter);
    paint_stack();
    for (int k = 0; k < COUNT; k++) {{
        uint32_t before = TIMER[2];
        update(k);
        uint32_t took = ((before - TIMER[2]) & 0xFFFFFF) * 40;
        total += took / 40;
        most = took > most ? took : most;
    }}
    while (*low == PAINT) {{
        low++;
    }}
    for (int i = 0; i < GIVEN; i++) {{
        print_real(out[i]);
    }}
    print_word('n', total / COUNT * 40);
    print_word('m', most);
    print_word('s', (uint32_t)(top - (char *)low));
    print_word('z', sizeof filter);
    call_host(0x18, (void *)0x20026);
    return 0;
}}

void reset(void)
{{
    *(volatile uint32_t *)0xE000ED88 |= 0xF00000; /* the floating-point unit */
    __asm__ volatile("dsb\\n isb");
    TIMER[1] = 0xFFFFFF;
    TIMER[0] = 5;
    main();
}}
"""
_ATTITUDE_UPDATE = """    {stem}_update(&filter, dt[k], gyro + 3 * k, has_accel[k] ? accel + 3 * k : NULL,
        has_mag[k] ? mag + 3 * k : NULL, out, out + 4, NULL);"""
_SPIN_UPDATE = """    int turns;
    {stem}_update(&filter, dt[k], has_accel[k] ? accel + k : NULL, has_square[k] ? square + k : NULL,
        direction[k], &turns, out, out + 1, out + 2);"""


@dataclass(frozen=True)
class OnTarget:
    """The resources that a filter needed on the emulated Cortex-M4F, in single precision."""

    last: NDArray[np.float32]  # q_nb and bias, or rest_rad, rate_radps and variances after the last sample
    code_bytes: int  # of the filter alone, with its constants
    state_bytes: int
    stack_bytes: int  # the most that an update used
    mean_instructions: int  # per update
    most_instructions: int


def list_missing_tools() -> list[str]:
    """Return the programs that are not installed."""
    return [tool for tool in _TOOLS if shutil.which(tool) is None]


def run_on_cortex_m4(made: CSource, log: Log | SpinLog, folder: Path) -> OnTarget:
    """Compile a filter for a Cortex-M4F, run it over a log in the emulator, and measure what it needs."""
    for name, text in (("layout.ld", _LAYOUT), (f"{made.stem}.h", made.header), (f"{made.stem}.c", made.source)):
        (folder / name).write_text(text)
    columns = {
        "dt": log.dt_s,
        **(
            {"accel": log.accel_radps2, "square": log.square_rad2ps2}
            if isinstance(log, SpinLog)
            else {"gyro": log.gyro_b_radps, "accel": log.accel_b_mps2, "mag": log.mag_b_ut}
        ),
    }
    masks = {
        "has_accel": log.has_accel,
        **({"has_square": log.has_square, "direction": log.direction} if isinstance(log, SpinLog) else {}),
        **({} if isinstance(log, SpinLog) else {"has_mag": log.has_mag}),
    }
    data = [f"enum {{ COUNT = {len(log.dt_s)}, GIVEN = {5 if isinstance(log, SpinLog) else 7} }};"]
    data += [f"static const float {name}[] = {{{_list_reals(values)}}};" for name, values in columns.items()]
    data += [
        f"static const signed char {name}[] = {{{', '.join(str(int(v)) for v in mask)}}};"
        for name, mask in masks.items()
    ]
    update = (_SPIN_UPDATE if isinstance(log, SpinLog) else _ATTITUDE_UPDATE).format(stem=made.stem)
    (folder / "start.c").write_text(_START.format(stem=made.stem, data="\n".join(data), update=update))
    compile_ = ["arm-none-eabi-gcc", *_CPU, *FLAGS]
    for stem in (made.stem, "start"):
        _run([*compile_, "-c", f"{stem}.c", "-o", f"{stem}.o"], folder)
    _run([*compile_, "-nostartfiles", "-T", "layout.ld", f"{made.stem}.o", "start.o", "-lm", "-o", "run.elf"], folder)
    code = int(_run(["arm-none-eabi-size", f"{made.stem}.o"], folder).splitlines()[1].split()[0])
    machine = ["qemu-system-arm", "-M", "mps2-an386", "-icount", "shift=0", "-nographic", "-monitor", "none"]
    target = ["-serial", "none", "-semihosting-config", "enable=on,target=native", "-kernel", "run.elf"]
    output = _run([*machine, *target], folder)
    words: dict[str, list[int]] = {}
    for kind, word in re.findall(r"^(\w)([0-9a-f]{8})$", output, flags=re.MULTILINE):
        words.setdefault(kind, []).append(int(word, 16))
    if "z" not in words:
        raise RuntimeError(f"{made.stem}: did not finish on the emulated target; it printed {output[-200:]!r}")
    last = np.array(words["r"], np.uint32).view(np.float32)
    return OnTarget(last, code, words["z"][0], words["s"][0], words["n"][0], words["m"][0])


def _list_reals(values: Any) -> str:
    """Return a column as C constants in single precision."""
    return ", ".join(f"{float(value).hex()}f" for value in np.asarray(values, np.float32).ravel())


def _run(words: list[str], folder: Path) -> str:
    """Run a program in a folder and return what it printed."""
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=_TIMEOUT_S)
    if done.returncode:
        raise RuntimeError(f"{words[0]} failed: {(done.stderr or done.stdout)[-2000:]}")
    return done.stdout + done.stderr
