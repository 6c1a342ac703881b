"""Handlers of signals: what they raise arrives, wherever the signal comes."""

import os
import pickle
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import llvmlite.binding as llvm
import pytest

from stillpoint.datasets import write
from stillpoint.datasets.simulate import simulate
from stillpoint.scripts.shared.children import Surroundings, start_child
from stillpoint.scripts.shared.signals import Interrupted, Unwinding

NUMBERS = (signal.SIGINT, signal.SIGTERM)
LONGEST_S = 60.0
MODULE = "define i32 @seven() {\n ret i32 7\n}"


@pytest.fixture(autouse=True)
def unwinding() -> Iterator[Unwinding]:
    made = Unwinding(NUMBERS)
    yield made
    made.stop()


def compile_and_call(function: Callable[[], object]) -> None:
    """Compile a module with llvmlite, which calls a function from native code as it does to keep the machine code."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(MODULE), machine)
    engine.set_object_cache(lambda _module, _code: function())
    engine.finalize_object()


class _Deleted:
    def __init__(self, function: Callable[[], object]) -> None:
        self.function = function

    def __del__(self) -> None:
        self.function()


def delete_and_call(function: Callable[[], object]) -> None:
    _Deleted(function)


def finalize_and_call(function: Callable[[], object]) -> None:
    owner = set()  # of a type that weak references may point to
    weakref.finalize(owner, function)
    del owner


def lose_and_wait(lose: Callable[[Callable[[], object]], None], function: Callable[[], object]) -> None:
    lose(function)
    time.sleep(LONGEST_S)


@pytest.mark.parametrize("lose", [compile_and_call, delete_and_call, finalize_and_call])
@pytest.mark.parametrize("number", NUMBERS)
def test_what_a_signal_raises_is_not_lost(
    number: signal.Signals, lose: Callable[[Callable[[], object]], None], capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(Interrupted, match=number.name):
        lose_and_wait(lose, partial(signal.raise_signal, number))
    assert capfd.readouterr().err == ""


def test_it_comes_again_until_it_is_not_lost(unwinding: Unwinding) -> None:
    lose_once = partial(lose_and_wait, delete_and_call, partial(signal.raise_signal, signal.SIGINT))
    with pytest.raises(Interrupted):
        lose_and_wait(delete_and_call, lose_once)
    assert unwinding.told == [signal.SIGINT] * 3  # lost within, lost on its way out, and then raised


def interrupt_unwinding(cleaned: list[str]) -> None:
    """Be interrupted, and terminated while cleaning up."""
    try:
        lose_and_wait(delete_and_call, partial(signal.raise_signal, signal.SIGINT))
    finally:
        signal.raise_signal(signal.SIGTERM)
        cleaned.append("up")


def test_a_second_signal_interrupts_the_unwinding() -> None:
    cleaned: list[str] = []
    with pytest.raises(Interrupted, match="SIGTERM"):
        interrupt_unwinding(cleaned)
    assert cleaned == []


def test_with_once_a_second_signal_is_ignored() -> None:
    """Not the one whose exception was lost, which is sent again."""
    once, cleaned = Unwinding(NUMBERS, once=True), list[str]()
    with pytest.raises(Interrupted, match="SIGINT"):
        interrupt_unwinding(cleaned)
    once.stop()
    assert cleaned == ["up"]


def test_other_exceptions_that_are_lost_are_said_until_a_signal_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda lost: said.append(lost.exc_value))
    within = Unwinding(NUMBERS)
    delete_and_call(lambda: [][0])
    assert [type(one) for one in said] == [IndexError]
    with pytest.raises(Interrupted):
        signal.raise_signal(signal.SIGINT)
    delete_and_call(lambda: [][0])  # as where half of the work was done when the signal came
    assert len(said) == 1
    within.stop()


def test_a_signal_that_is_ignored_stays_ignored(unwinding: Unwinding) -> None:
    unwinding.stop()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    Unwinding(NUMBERS).stop()
    within = Unwinding(NUMBERS)
    assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    within.stop()
    signal.signal(signal.SIGINT, before)


COMMAND = """
import os, sys
from llvmlite.binding.executionengine import ExecutionEngine
from stillpoint.scripts.main import main
find_module = ExecutionEngine._find_module_ptr
def be_signalled_and_find_module(self, pointer):
    os.kill(os.getpid(), number)
    return find_module(self, pointer)
number = int(sys.argv.pop(1))
ExecutionEngine._find_module_ptr = be_signalled_and_find_module  # the callbacks from native code call it
main()
"""


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_command_ends_without_a_word_while_it_compiles(number: signal.Signals, code: int, tmp_path: Path) -> None:
    write(tmp_path / "hand.mcap", simulate("phone-1", minutes=0.6))
    command = [sys.executable, "-c", COMMAND, str(int(number)), "estimate", "hand.mcap", "-e", "cf"]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "empty")}
    result = subprocess.run(
        command,
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
    )
    errors = [line for line in result.stderr.splitlines() if "compiling" not in line]
    assert (result.returncode, errors) == (code, [])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "hand.mcap"]


def be_terminated_while_compiling(_: object) -> None:
    compile_and_call(lambda: signal.raise_signal(signal.SIGTERM))
    time.sleep(LONGEST_S)


def be_terminated_during_an_import(_: object) -> None:
    try:
        signal.raise_signal(signal.SIGTERM)
    except BaseException:
        raise ImportError("cannot import") from None  # as a compiled module does


@pytest.mark.slow
@pytest.mark.parametrize("function", [be_terminated_while_compiling, be_terminated_during_an_import])
def test_a_child_ends_without_a_word_where_its_signal_is_hidden(
    function: Callable[[object], None], capfd: pytest.CaptureFixture[str]
) -> None:
    child = start_child(pickle.dumps(function), Surroundings())
    child.send(())
    assert "exit code 1" in str(child.receive().error)
    assert capfd.readouterr().err == ""
