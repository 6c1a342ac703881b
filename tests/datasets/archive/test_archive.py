"""The archive keeps every file once and whole, whatever happens to the process that adds it."""

import hashlib
import multiprocessing
import os
import signal
import sqlite3
import subprocess
import sys
import time
from datetime import timedelta
from pathlib import Path

import pytest
from shelf import write_family, write_recording

from stillpoint.datasets import read
from stillpoint.datasets.archive import archive as archive_module
from stillpoint.datasets.archive import catalogue, create_archive, open_archive, resolve_paths
from stillpoint.datasets.archive.verify import verify_archive
from stillpoint.datasets.errors import BadFile, BadParameter


@pytest.fixture
def family(tmp_path):
    folder = tmp_path / "files"
    folder.mkdir()
    return write_family(folder)


@pytest.fixture
def archive(tmp_path):
    with create_archive(tmp_path / "archive") as opened:
        yield opened


def sha256_of(path):
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def test_objects_are_named_by_their_hash_and_readable_without_this_program(archive, family):
    added = list(archive.add(family))
    assert [one.status for one in added] == ["added"] * 3
    assert [one.kind for one in added] == ["recording", "reference", "estimate"]
    for one, file in zip(added, family, strict=True):
        kept = archive.home / "objects" / one.sha256[:2] / f"{one.sha256[2:]}.mcap"
        assert sha256_of(kept) == one.sha256 == sha256_of(file)
        assert sha256_of(archive.home / "names" / file.name) == one.sha256
    assert read(archive.home / "names" / "run.mcap").name == "run"


def test_the_same_bytes_are_kept_once(archive, family, tmp_path):
    list(archive.add(family))
    copy = tmp_path / "other_name.mcap"
    copy.write_bytes(family[0].read_bytes())
    assert [one.status for one in archive.add([copy, copy])] == ["present", "present"]
    assert len(list((archive.home / "objects").rglob("*.mcap"))) == 3


def test_two_files_with_one_name_get_two_links(archive, tmp_path):
    for seed in (1, 2):
        (tmp_path / str(seed)).mkdir()
        list(archive.add([write_recording(tmp_path / str(seed) / "run.mcap", seed)]))
    first, second = archive.find("kind:recording")
    assert first.link == "run.mcap"
    assert second.link == f"run~{second.sha256[:8]}.mcap"
    assert sha256_of(archive.find_path(second)) == second.sha256
    with pytest.raises(BadParameter, match="names 2 objects"):
        archive.resolve("run")


def test_a_damaged_mcap_file_is_refused_and_the_others_are_kept(archive, family):
    data = bytearray(family[0].read_bytes())
    data[len(data) // 2] ^= 1
    broken = family[0].with_name("broken.mcap")
    broken.write_bytes(data)
    statuses = {one.source.name: one for one in archive.add([broken, *family, family[0].with_name("absent.mcap")])}
    assert statuses["broken.mcap"].status == "refused"
    assert "broken.mcap" in statuses["broken.mcap"].reason
    assert statuses["absent.mcap"].status == "refused"
    assert [statuses[file.name].status for file in family] == ["added"] * 3
    assert not list((archive.home / "incoming").iterdir())


def test_deleting_the_catalogue_loses_nothing(archive, family):
    list(archive.add(family, ["fast", "lab"], {"subject": "anna"}))
    archive.label([archive.resolve("run").sha256], ["extra"], ["lab"])
    before = archive.catalogue.dump()
    archive.close()
    for file in archive.home.glob("catalogue.sqlite*"):
        file.unlink()
    with open_archive(archive.home) as again:
        assert again.catalogue.dump() == before
        assert again.rebuild() == []
        assert again.catalogue.dump() == before
        assert [entry.name for entry in again.find("tag:extra and meta.subject = anna")] == ["run"]


def test_a_catalogue_that_is_no_database_gives_one_line_error(archive, family):
    list(archive.add(family))
    archive.close()
    (archive.home / "catalogue.sqlite").write_bytes(b"no database at all" * 100)
    with pytest.raises(BadFile, match="archive rebuild: nothing is lost"):
        open_archive(archive.home)


def test_removal_keeps_a_tombstone_and_gc_frees_only_what_is_marked(archive, family):
    recording, reference, estimate = (one.sha256 for one in archive.add(family))
    with pytest.raises(BadParameter, match="2 objects were made from it"):
        archive.remove([recording], "wrong subject")
    assert {entry.sha256 for entry in archive.remove([estimate], "wrong settings")} == {estimate}
    assert [entry.sha256 for entry in archive.find("all")] == [recording, reference]
    assert archive.list_removable(timedelta(days=1)) == []
    archive.collect(archive.list_removable(timedelta(0)))
    assert not archive.storage.has(archive.read_record(estimate).object_key)
    assert archive.storage.has(archive.read_record(reference).object_key)
    tombstone = archive.read_record(estimate)
    assert tombstone.reason == "wrong settings"
    assert tombstone.removed <= tombstone.freed
    assert verify_archive(archive).faults == ()
    assert [one.status for one in archive.add([family[2]])] == ["restored"]
    assert len(archive.find("all")) == 3


def test_ids_names_and_lines_of_find_become_paths(archive, family):
    list(archive.add(family))
    entries = archive.find("all")
    lines = [f"{entry.sha256}\t{entry.kind}\t{entry.file_name}\n" for entry in entries]
    paths = resolve_paths(archive.home, lines)
    assert [path.name for path in paths] == [file.name for file in family]
    assert resolve_paths(archive.home, [entries[0].sha256[:8], "run.reference.mcap"]) == paths[:2]
    with pytest.raises(BadParameter, match="no such object"):
        resolve_paths(archive.home, ["nothing"])


def test_the_views_answer_plain_sql(archive, family):
    list(archive.add(family))
    reader = sqlite3.connect(archive.home / "catalogue.sqlite")
    assert reader.execute("SELECT name, samples, rate_hz FROM recordings").fetchall() == [("run", 400, 100.0)]
    assert reader.execute('SELECT method, sd_median_deg > 0.9 FROM "references"').fetchall() == [("graph", 1)]
    assert reader.execute("SELECT estimator FROM estimates").fetchall() == [("ekf",)]
    assert reader.execute("SELECT DISTINCT parent_kind FROM provenance").fetchall() == [("recording",)]
    assert reader.execute("PRAGMA user_version").fetchone() == (1,)


def test_an_archive_is_made_in_an_empty_folder_only(tmp_path):
    (tmp_path / "file").write_text("here already")
    with pytest.raises(BadParameter, match="not an empty folder"):
        create_archive(tmp_path)
    with pytest.raises(BadParameter, match="is not an archive"):
        open_archive(tmp_path)


@pytest.mark.parametrize("left", [(), ("stillpoint-archive.txt",)])
def test_an_interrupted_init_does_not_keep_the_next_from_its_folder(tmp_path, left):
    incoming = tmp_path / "lab" / "incoming"
    incoming.mkdir(parents=True)
    for name in left:
        (incoming / name).write_text("half of the te")
    create_archive(tmp_path / "lab").close()
    open_archive(tmp_path / "lab").close()


ADD = """
import sys
from pathlib import Path
from stillpoint.datasets.archive import open_archive
with open_archive(sys.argv[1]) as archive:
    print("ready", flush=True)
    for one in archive.add(sorted(Path(sys.argv[2]).glob("*.mcap"))):
        print(one.sha256, flush=True)
"""


def start_adding(archive_dir, files):
    return subprocess.Popen(
        [sys.executable, "-c", ADD, str(archive_dir), str(files)], stdout=subprocess.PIPE, text=True
    )


@pytest.mark.slow
def test_killed_adders_lose_nothing_that_was_said_to_be_kept(archive, tmp_path):
    files = tmp_path / "many"
    files.mkdir()
    for seed in range(40):
        write_recording(files / f"r{seed:02d}.mcap", seed, n=50)
    promised = set()
    for delay_s in (0.0, 0.02, 0.05, 0.1, 0.15):
        adder = start_adding(archive.home, files)
        assert adder.stdout.readline() == "ready\n"
        time.sleep(delay_s)
        os.kill(adder.pid, signal.SIGKILL)
        promised |= {line.strip() for line in adder.stdout if len(line) == 65}
        adder.wait()
        archive.finish_interrupted()
        assert not list((archive.home / "incoming").iterdir())
        assert verify_archive(archive).faults == ()
    assert promised <= {entry.sha256 for entry in archive.find("all")}
    list(archive.add(sorted(files.glob("*.mcap"))))
    assert len(archive.find("all")) == 40
    assert verify_archive(archive).faults == ()


def _add_and_die(archive_dir, files, step):
    """Add the files, and kill this process before or after the given step, a call that changes files."""
    left = step

    def die_in_turn(function):
        def wrapped(*args, **kwargs):
            nonlocal left
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            result = function(*args, **kwargs)
            left -= 1
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            return result

        return wrapped

    with open_archive(archive_dir) as opened:
        for owner, name in (
            (os, "replace"),
            (os, "link"),
            (os, "symlink"),
            (Path, "rename"),
            (Path, "unlink"),
            (archive_module, "put_object"),
            (catalogue.Catalogue, "change"),
            (os, "rmdir"),
        ):
            setattr(owner, name, die_in_turn(getattr(owner, name)))
        list(opened.add(sorted(files.glob("*.mcap"))))


@pytest.mark.slow
def test_a_process_killed_at_any_step_leaves_all_or_nothing_of_each_file(tmp_path):
    files = tmp_path / "files"
    files.mkdir()
    write_family(files)
    counts, fork = set(), multiprocessing.get_context("fork")  # no archive is open while it forks
    for step in range(1, 200, 2):
        home = tmp_path / f"archive{step}"
        create_archive(home).close()
        ended = fork.Process(target=_add_and_die, args=(home, files, step))
        ended.start()
        ended.join()
        assert ended.exitcode in (0, -signal.SIGKILL), step
        with open_archive(home) as archive:
            levels = {fault.level for fault in verify_archive(archive).faults}
            assert levels <= {"provenance"}, step  # the estimate may be there and its recording not yet
            assert not list((home / "incoming").iterdir()), step
            counts.add(len(archive.find("all")))
            list(archive.add(sorted(files.glob("*.mcap"))))
            assert verify_archive(archive).faults == (), step
        if ended.exitcode == 0:
            break
    assert ended.exitcode == 0
    assert step > 20
    assert {0, 3} <= counts


def test_an_interrupted_command_is_completed_by_the_next(archive, family, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("stillpoint.datasets.archive.archive.put_object", interrupt)
        with pytest.raises(KeyboardInterrupt):
            list(archive.add(family))
    assert archive.find("all") == []
    assert archive.finish_interrupted() == 1
    assert len(archive.find("all")) == 3
    assert verify_archive(archive).faults == ()


def _add_all(archive_dir, files, results):
    with open_archive(archive_dir) as archive:
        results.put([one.status for one in archive.add(files)])


@pytest.mark.slow
def test_two_adders_at_once_keep_everything_once(archive, tmp_path):
    files = [write_recording(tmp_path / f"r{seed:02d}.mcap", seed, n=50) for seed in range(30)]
    context = multiprocessing.get_context("spawn")
    results = context.Queue()
    adders = [context.Process(target=_add_all, args=(archive.home, some, results)) for some in (files, files[::-1])]
    for adder in adders:
        adder.start()
    statuses = [status for _ in adders for status in results.get(timeout=120)]
    for adder in adders:
        adder.join()
    assert set(statuses) <= {"added", "present"}
    assert len(archive.find("all")) == 30
    assert verify_archive(archive).faults == ()
