"""Atomic files: the old content or the new one, and no debris of processes that were killed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from stillpoint.datasets.files import atomic
from stillpoint.datasets.files.atomic import remove_stale_parts, write_atomically, write_folder_atomically

WRITE_AND_WAIT = """
import sys, time
from pathlib import Path
from stillpoint.datasets.files.atomic import write_atomically
with write_atomically(Path(sys.argv[1])) as file:
    file.write(b"half")
    file.flush()
    print("writing", flush=True)
    time.sleep(60)
"""


def start_writer(target: Path) -> subprocess.Popen[str]:
    writer = subprocess.Popen([sys.executable, "-c", WRITE_AND_WAIT, str(target)], stdout=subprocess.PIPE, text=True)
    assert writer.stdout is not None
    assert writer.stdout.readline() == "writing\n"
    return writer


def list_parts(folder: Path) -> list[Path]:
    return list(folder.glob(".*.part"))


@pytest.mark.skipif(not hasattr(os, "posix_fadvise"), reason="the system takes no such advice")
def test_a_long_file_leaves_the_cache_but_for_its_end_and_holds_what_was_written(tmp_path, monkeypatch):
    monkeypatch.setattr(atomic, "_BUFFER_BYTES", 1000)
    monkeypatch.setattr(atomic, "_STRIDE_BYTES", 20_000)
    monkeypatch.setattr(atomic, "_CACHED_BYTES", 50_000)
    sent = []
    monkeypatch.setattr(os, "posix_fadvise", lambda file, begin, length, advice: sent.append((begin, length)))
    blocks = [bytes([k % 251]) * 1700 for k in range(100)]
    with write_atomically(tmp_path / "long", leaves_cache=True) as file:
        for block in blocks:
            file.write(block)
    assert (tmp_path / "long").read_bytes() == b"".join(blocks)
    assert len(sent) == 120_000 // 20_000 - 1, "a stride at a time"
    assert all(begin == 0 and length <= 170_000 - 50_000 for begin, length in sent)
    assert sorted(sent) == sent


def test_failed_write_leaves_the_old_content_and_no_part(tmp_path):
    target = tmp_path / "a.json"
    target.write_bytes(b"old")

    def fail_in_the_middle() -> None:
        with write_atomically(target) as file:
            file.write(b"new")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_in_the_middle()
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_link_and_mode_of_the_old_file_are_kept(tmp_path):
    target, link = tmp_path / "a.json", tmp_path / "link.json"
    target.write_bytes(b"old")
    target.chmod(0o640)
    link.symlink_to(target)
    with write_atomically(link) as file:
        file.write(b"new")
    assert link.is_symlink()
    assert target.read_bytes() == b"new"
    assert target.stat().st_mode & 0o777 == 0o640


@pytest.mark.slow
def test_killed_writer_leaves_a_part_that_the_next_write_removes(tmp_path):
    writer = start_writer(tmp_path / "a.mcap")
    writer.kill()
    writer.wait()
    assert len(list_parts(tmp_path)) == 1
    assert not (tmp_path / "a.mcap").exists()
    code = "import sys; from pathlib import Path; from stillpoint.datasets.files.atomic import write_atomically\n"
    code += "with write_atomically(Path(sys.argv[1])) as file: file.write(b'whole')"
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "b.mcap")], check=True)
    assert [file.name for file in tmp_path.iterdir()] == ["b.mcap"]


@pytest.mark.slow
def test_part_of_a_running_process_is_kept(tmp_path):
    writer = start_writer(tmp_path / "a.mcap")
    try:
        assert remove_stale_parts(tmp_path) == 0
        assert len(list_parts(tmp_path)) == 1
    finally:
        writer.kill()
        writer.wait()
    assert remove_stale_parts(tmp_path) == 1


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="the start of a process is read from /proc")
def test_part_of_a_dead_process_whose_number_was_reused_is_removed(tmp_path):
    with write_atomically(tmp_path / "a") as _:
        name = list_parts(tmp_path)[0].name
    reused = name.rsplit(".", 2)[0] + ".1.part"  # this process, but as if it had started just after boot
    (tmp_path / reused).touch()
    assert remove_stale_parts(tmp_path) == 1


@pytest.mark.parametrize("name", [".a.abc.other-host.1.1.part", ".download.part", "a.part", ".a.part"])
def test_foreign_parts_are_never_touched(tmp_path, name):
    (tmp_path / name).touch()
    assert remove_stale_parts(tmp_path) == 0
    assert (tmp_path / name).exists()


@pytest.mark.slow
@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_verb_told_to_end_exits_quietly_and_leaves_nothing(tmp_path, sent, code):
    """The signal comes while `simulate` writes."""
    verb = _start_and_stop_while_writing(tmp_path)
    verb.send_signal(sent)
    verb.send_signal(signal.SIGCONT)
    _, stderr = verb.communicate()
    assert "Traceback" not in stderr
    assert verb.returncode == code
    assert list(tmp_path.iterdir()) == []


def _take_interrupts():
    """Undo what a shell does to a test run in its background: children inherit that SIGINT is ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _start_and_stop_while_writing(folder):
    """Return the process of a verb that was stopped (SIGSTOP) while a part of its file was there."""
    command = [sys.executable, "-c", "from stillpoint.scripts.main import main; main()", "simulate", "phone-1"]
    for _ in range(10):  # on a busy machine, the whole file may be written between two looks
        verb = subprocess.Popen(
            [*command, "--minutes", "6", "-o", str(folder)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=_take_interrupts,
        )
        while verb.poll() is None and not list_parts(folder):
            time.sleep(0.002)
        verb.send_signal(signal.SIGSTOP)
        time.sleep(0.05)  # until it has stopped
        if list_parts(folder):
            return verb
        verb.send_signal(signal.SIGCONT)
        verb.communicate()
        for path in folder.iterdir():
            path.unlink()
    raise AssertionError("no part of a file was seen in ten runs")


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    with write_folder_atomically(tmp_path / "made") as folder:
        (folder / "below").mkdir()
        (folder / "below" / "a").write_bytes(b"whole")
        assert not (tmp_path / "made").exists()
    assert (tmp_path / "made" / "below" / "a").read_bytes() == b"whole"
    with pytest.raises(ZeroDivisionError), write_folder_atomically(tmp_path / "other") as folder:
        (folder / "a").write_bytes(bytes(1 // 0))
    assert [path.name for path in tmp_path.iterdir()] == ["made"]


def test_the_folder_of_a_dead_process_is_removed(tmp_path):
    with write_atomically(tmp_path / "a") as _:
        name = list_parts(tmp_path)[0].name
    dead = tmp_path / (name.rsplit(".", 2)[0] + ".1.part")
    dead.mkdir()
    (dead / "half").touch()
    assert remove_stale_parts(tmp_path) == 1
    assert not dead.exists()
