"""Modules that are run by ``python -m``: help and wrong arguments end as those of the verbs do."""

import pkgutil
import re
from importlib.util import find_spec
from pathlib import Path

import pytest

import stillpoint.scripts.bench
import stillpoint.scripts.pages
from stillpoint.datasets.errors import BadParameter
from stillpoint.scripts.program import run_program

PROGRAMS = [
    name
    for package in (stillpoint.scripts.bench, stillpoint.scripts.pages)
    for _, name, _ in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    if "run_program" in Path(str(find_spec(name).origin)).read_text(encoding="utf-8")
]


def _run(function, *tokens):
    with pytest.raises(SystemExit) as end:
        run_program(function, tokens)
    return end.value.code


def _copy(source: Path, times: int = 1) -> int:
    """Copy."""
    if times < 0:
        raise BadParameter(f"times {times}: give 0 or more")
    return len(source.read_bytes()) * times


def test_all_programs_are_found():
    assert len(PROGRAMS) > 15


@pytest.mark.parametrize("name", PROGRAMS)
def test_program_has_help_and_refuses_an_unknown_option_in_one_line(name, capsys):
    module = pytest.importorskip(name)
    assert _run(module.main, "--help") == 0
    first = re.findall(r"\w+", module.__doc__)[:5]
    assert re.findall(r"\w+", capsys.readouterr().out.partition("\n\n")[2])[:5] == first
    assert _run(module.main, "--no-such-option") == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert "--no-such-option" in printed.err


def test_code_of_function_is_exit_code(tmp_path):
    (tmp_path / "a").write_bytes(b"12")
    assert _run(_copy, str(tmp_path / "a"), "--times", "3") == 6


@pytest.mark.parametrize(
    ("tokens", "named"),
    [
        ((), "--source"),
        (("x", "--times", "a lot"), "a lot"),
        (("no/such/file",), "no/such/file"),
        (("x", "-1"), "times"),
    ],
)
def test_errors_of_user_are_one_line(tokens, named, capsys):
    assert _run(_copy, *tokens) == 2
    printed = capsys.readouterr().err
    assert printed.startswith("stillpoint: ")
    assert printed.count("\n") == 1
    assert named in printed
