"""The root of the command line: one line and exit code 2 for what the user can put right, and a light help page."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from stillpoint.datasets import write
from stillpoint.datasets.simulate import simulate
from stillpoint.scripts import main as command
from stillpoint.scripts.verbs import demo

HEAVY = ("numpy", "numba", "gtsam", "matplotlib", "scipy", "rosbags")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["inof", "x.mcap"], "did you mean 'info'"),
        (["frobnicate"], "there are demo, fetch, import"),
        (["--nonsense"], "no verb '--nonsense'; there are demo, fetch, import"),
        (["simulate", "phone-9"], "phone-3"),
        (["simulate", "phone-3", "--sed", "1"], "--seed"),
        (["simulate", "phone-3", "--minutes", "soon"], "minutes"),
        (["info", "no-such-file.mcap"], "no-such-file.mcap"),
        (["validate", "no-such-folder"], "no-such-folder"),
        (["import", "broad", "no-such-folder", "-o", "x"], "no-such-folder"),
        (["info"], "PATHS requires an argument"),
        (["doctor"], "PATHS requires an argument"),
        (["simulate", "phone-1", "--seed", "1.5"], "'1.5' is not a whole number"),
        (["demo", "--minutes", "0.1"], "at least 1.38"),
        (["simulate", "phone-1", "--json", "no/such/folder/x.json"], "Its folder does not exist"),
        (["simulate", "phone-1", "--json", "."], "It is a folder"),
    ],
)
def test_a_wrong_call_gives_one_line_error_and_exit_code_2(
    call,
    words: list[str],
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(*words) == 2
    printed = capsys.readouterr()
    assert len(printed.err.strip().splitlines()) == 1, printed.err
    assert printed.err.startswith("stillpoint: ")
    assert says in printed.err
    assert printed.out == ""
    assert list(tmp_path.iterdir()) == []


READERS = ("info", "doctor", "reference", "estimate", "validate", "report")
IMPORTED = ("broad", "tyrex", "bench", "csv", "sensorlogger", "phyphox", "ros")


@pytest.fixture
def oddities(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Things that are no recordings, in the working folder."""
    monkeypatch.chdir(tmp_path)
    for name in ("empty", "full"):
        (tmp_path / name).mkdir()
    for name in ("text.mcap", "notes.txt", "full/text.mcap"):
        (tmp_path / name).write_text("hello\n" * 30)
    (tmp_path / "zero.mcap").touch()
    return tmp_path


@pytest.mark.parametrize("name", ["empty", "full", "text.mcap", "notes.txt", "zero.mcap", "*.nope", "/dev/null"])
@pytest.mark.parametrize("verb", [*READERS, "score"])
def test_what_is_no_recording_is_named_in_one_line(call, oddities, capsys, verb: str, name: str) -> None:
    assert call(verb, name) == 2
    printed = capsys.readouterr()
    assert len(printed.err.strip().splitlines()) == 1, printed.err
    assert printed.err.startswith(f"stillpoint: {name}")
    assert printed.out == ""


@pytest.mark.parametrize("name", ["empty", "full", "text.mcap", "zero.mcap"])
@pytest.mark.parametrize("kind", IMPORTED)
def test_what_is_no_source_is_named_in_one_line(call, oddities, capsys, kind: str, name: str) -> None:
    assert call("import", kind, name, "-o", "out", *(["--rate", 100] if kind == "csv" else [])) == 2
    printed = capsys.readouterr()
    assert len(printed.err.strip().splitlines()) == 1, printed.err
    assert printed.err.startswith(f"stillpoint: {name}")
    assert printed.out == ""
    assert not (oddities / "out").exists()


@pytest.mark.parametrize("verb", ["reference", "estimate", "report"])
@pytest.mark.parametrize("out", ["notes.txt", "notes.txt/below", "/proc/nowhere"])
def test_a_folder_that_cannot_be_written_gives_one_line_error(call, oddities, capsys, verb: str, out: str) -> None:
    write(oddities / "good.mcap", simulate("phone-1", minutes=0.6))
    assert call(verb, "good.mcap", "-o", out) == 2
    printed = capsys.readouterr()
    assert len(printed.err.strip().splitlines()) == 1, printed.err
    assert printed.err.startswith(f"stillpoint: {out}")


@pytest.mark.parametrize("words", [["reference"], ["estimate"], ["report"], ["doctor", "--apply"]])
def test_two_recordings_of_one_name_are_not_written_over_each_other(call, oddities, capsys, words: list[str]) -> None:
    for folder in ("empty", "full"):
        write(oddities / folder / "good.mcap", simulate("phone-1", minutes=0.6))
    assert call(*words, "empty/good.mcap", "full/good.mcap", "-o", "out") == 2
    assert "two recordings have this name" in capsys.readouterr().err
    assert list((oddities / "out").iterdir()) == []


@pytest.mark.parametrize("verb", ["info", pytest.param("doctor", marks=pytest.mark.slow)])
def test_the_readable_files_are_shown_and_the_others_named(call, oddities, capsys, verb: str) -> None:
    write(oddities / "full" / "good.mcap", simulate("phone-1", minutes=0.6))
    assert call(verb, "full") == 2
    printed = capsys.readouterr()
    errors = [line for line in printed.err.splitlines() if " done after " not in line]  # of a slow machine
    assert errors[0].startswith("stillpoint: full/text.mcap: ")
    assert "full/good.mcap: " in printed.out
    assert call(verb, "full", "--json", "-") == 2
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert any("text.mcap" in str(row.get("error") or row.get("message")) for row in rows)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_during_the_import_of_a_compiled_module_is_no_defect(
    number: int, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such a module raises ImportError instead of what the signal raised."""

    def interrupted() -> None:
        try:
            signal.raise_signal(number)
        except BaseException as raised:
            raise ImportError("cannot import") from (raised if number == signal.SIGINT else None)

    monkeypatch.setattr(command, "app", lambda: lambda *_, **__: interrupted())
    with pytest.raises(SystemExit) as stop:
        command.main(["info", "x"])
    assert stop.value.code == code


@pytest.mark.slow
def test_the_installed_command_ends_with_these_codes() -> None:
    command_file = Path(sys.executable).with_name("stillpoint")
    result = subprocess.run([command_file, "info", "no-such-file.mcap"], capture_output=True, text=True)
    assert result.returncode == 2
    assert result.stderr == "stillpoint: no-such-file.mcap: there is no such file or folder; check the name\n"


@pytest.mark.slow
def test_help_names_every_verb_and_imports_nothing_heavy() -> None:
    code = (
        "import sys\nfrom stillpoint.scripts.main import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        f"print([m for m in {HEAVY} if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip().endswith("[]")
    assert all(verb in result.stdout for verb in command.VERBS)


@pytest.mark.parametrize("verb", sorted(command.VERBS))
def test_every_verb_explains_itself_and_its_options(call, verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(verb, "--help") == 0
    page = capsys.readouterr().out
    assert f"Usage: stillpoint {verb}" in page
    rows = [line for line in page.splitlines() if line.startswith("│")]
    of_commands = f"Usage: stillpoint {verb} COMMAND" in page
    assert rows, "an empty page"
    assert of_commands or any("--" in row for row in rows), "no option is explained"


def test_the_demo_leaves_out_what_is_not_installed(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert demo._list_installed() == ["cf", "ekf"]
    assert capsys.readouterr().err.startswith("left out: vqf, offline-vqf, madgwick;")


def test_a_defect_is_a_traceback_and_exit_code_1(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> None:
        raise ZeroDivisionError("planted")

    monkeypatch.setattr(command, "app", lambda: lambda *_, **__: broken())
    with pytest.raises(ZeroDivisionError):
        command.main(["info", "x"])


def test_interrupt_ends_with_130(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "app", lambda: lambda *_, **__: interrupted())
    with pytest.raises(SystemExit) as stop:
        command.main(["info", "x"])
    assert stop.value.code == 130


@pytest.mark.slow
@pytest.mark.parametrize("words", [["export", "."], ["--help"]])
def test_a_reader_that_has_seen_enough_is_no_error(tmp_path: Path, words: list[str]) -> None:
    """The output is closed before the first line is written, as behind ``| head -0``."""
    for name in ("a", "b"):
        write(tmp_path / f"{name}.mcap", simulate("phone-1", minutes=0.6))
    command_file = Path(sys.executable).with_name("stillpoint")
    read_end, write_end = os.pipe()
    os.close(read_end)
    result = subprocess.run([command_file, *words], cwd=tmp_path, stdout=write_end, stderr=subprocess.PIPE, text=True)
    os.close(write_end)
    errors = [line for line in result.stderr.splitlines() if " done after " not in line]  # of a slow machine
    assert (result.returncode, errors) == (0, [])


@pytest.mark.slow
def test_importing_the_package_leaves_the_name_datasets_free() -> None:
    code = "import stillpoint.datasets, sys; print('datasets' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=Path("/"), check=True)
    assert result.stdout.strip() == "False"


def run_stillpoint(*words: str, **options) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own, as its standard output matters."""
    code = "import sys; from stillpoint.scripts.main import main; main(sys.argv[1:])"
    return subprocess.run(
        [sys.executable, "-c", code, *words], stderr=subprocess.PIPE, text=True, check=False, **options
    )


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "small.mcap"
    write(path, simulate("phone-1", seed=1, minutes=0.6))
    return path


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_standard_output_gives_one_line_error_and_no_success(small: Path) -> None:
    with open("/dev/full", "w") as full:
        done = run_stillpoint("info", str(small), "--json", "-", stdout=full)
    assert done.returncode == 2
    errors = [line for line in done.stderr.splitlines() if line.startswith("stillpoint: ")]
    assert len(errors) == 1  # a slow machine may print lines of progress before it
    assert errors[0].startswith("stillpoint: the standard output cannot be written (No space left")
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_a_closed_standard_output_is_refused(small: Path) -> None:
    done = run_stillpoint("info", str(small), preexec_fn=lambda: os.close(1))
    assert done.returncode == 2
    assert "standard output is closed" in done.stderr


def test_names_are_data(call, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Escape sequences and line ends in a name do not reach the terminal, and brackets are no JSON."""
    assert call("info", tmp_path / "a\x1b[31m\nb.mcap") == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "a\\x1b[31m\\nb.mcap" in err
    assert call("info", "[x]*.mcap") == 2
    assert "[x]*.mcap: there is no such file" in capsys.readouterr().err


def test_the_traceback_of_an_error_is_shown_when_asked(
    call, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.mat").write_bytes(b"not a mat file")
    assert call("import", "broad", tmp_path / "x.mat", "-o", tmp_path) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert call("import", "broad", tmp_path / "x.mat", "-o", tmp_path, "--debug") == 2
    assert "Traceback" in capsys.readouterr().err
