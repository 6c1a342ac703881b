"""Results kept by content: nothing is computed twice, and whatever decides a result makes it anew when it changes."""

import os
import shutil
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from farm_work import lines, note

from stillpoint.datasets import Estimate, write
from stillpoint.datasets.errors import BadParameter, Unobservable
from stillpoint.datasets.mcap.store import read_origin, sha256
from stillpoint.datasets.recording import Floats
from stillpoint.scripts.shared import kept
from stillpoint.scripts.shared.flags import LOCAL, Workers
from stillpoint.scripts.shared.kept import REUSE, Deciding, Keeping, run_kept


@dataclass(frozen=True, eq=False)
class Figures:
    """A result with an array, an optional number and one that is not finite."""

    sizes: Floats
    sd: float | None
    worst: float


def measure(task, log):
    """Work of a test: note that it ran, and do as the file says."""
    text = task.item.read_text()
    note(log, text)
    if text == "refused":
        raise Unobservable(f"{task.item}: does not fix it")
    if text == "package":
        raise BadParameter("a package is missing")
    if text == "defect":
        raise ZeroDivisionError
    return Figures(np.array([len(text), 0.1]), None, float("inf"))


def decide(path, scale=1.0):
    return Deciding((path,), {"scale": scale})


def run(paths, log, keeping=REUSE, scale=1.0, what="measure"):
    return run_kept(
        partial(measure, log=log), paths, partial(decide, scale=scale), LOCAL, keeping, what, Figures, here_up_to=99
    )


@pytest.fixture
def log(tmp_path):
    return tmp_path / "log"


def make_files(folder, *texts):
    folder.mkdir(exist_ok=True)
    paths = [folder / f"{k}.txt" for k in range(len(texts))]
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text)
    return paths


def test_a_second_run_computes_nothing_and_says_so(tmp_path, log, capfd):
    paths = make_files(tmp_path / "in", "a", "bb")
    first = run(paths, log)
    assert capfd.readouterr().err == ""
    second = run(paths, log)
    assert lines(log) == ["a", "bb"]
    assert "measure: all 2 results are kept from an earlier run, nothing to compute" in capfd.readouterr().err
    assert [one.kept for one in first] == [False, False]
    assert [one.kept for one in second] == [True, True]
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.value.sizes, other.value.sizes)
        assert (one.value.sd, one.value.worst) == (other.value.sd, other.value.worst)


def test_what_is_new_or_changed_is_computed_and_the_rest_is_kept(tmp_path, log, capfd):
    paths = make_files(tmp_path / "in", "a", "b")
    run(paths, log)
    paths[0].write_text("changed")
    more = [*paths, *make_files(tmp_path / "more", "c")]
    assert [one.kept for one in run(more, log)] == [False, True, False]
    assert lines(log)[2:] == ["changed", "c"]
    assert "1 of 3 kept from an earlier run, 2 to compute" in capfd.readouterr().err


@pytest.mark.parametrize("change", [{"scale": 2.0}, {"what": "other"}, {"keeping": Keeping(force=True)}])
def test_settings_the_verb_and_force_compute_anew(tmp_path, log, change):
    paths = make_files(tmp_path / "in", "a")
    run(paths, log)
    assert not run(paths, log, **change)[0].kept
    assert len(lines(log)) == 2


def test_the_same_content_in_another_folder_is_the_same_work(tmp_path, log):
    run(make_files(tmp_path / "in", "a"), log)
    shutil.copytree(tmp_path / "in", tmp_path / "copy")
    assert run([tmp_path / "copy" / "0.txt"], log)[0].kept


def test_refusals_are_kept_and_name_the_present_file(tmp_path, log):
    paths = make_files(tmp_path / "in", "refused")
    assert [run(paths, log)[0].kept for _ in range(2)] == [False, True]
    shutil.copytree(tmp_path / "in", tmp_path / "copy")
    (moved,) = run([tmp_path / "copy" / "0.txt"], log)
    assert str(tmp_path / "copy") in moved.error


@pytest.mark.parametrize("text", ["package", "defect"])
def test_errors_that_another_run_may_not_meet_are_not_kept(tmp_path, log, text, capfd):
    paths = make_files(tmp_path / "in", text)
    assert not any(run(paths, log)[0].kept for _ in range(2))
    assert lines(log) == [text, text]


def test_a_file_that_cannot_be_read_is_left_to_the_work(tmp_path, log):
    (outcome,) = run([tmp_path / "missing.txt"], log)
    assert "FileNotFoundError" in outcome.error


def test_results_that_cannot_be_kept_are_given_all_the_same(tmp_path, log, capfd):
    (tmp_path / "file").write_text("no folder")
    paths = make_files(tmp_path / "in", "a", "b")
    outcomes = run(paths, log, Keeping(results=tmp_path / "file" / "below"))
    assert all(one.error is None for one in outcomes)
    assert capfd.readouterr().err.count("results are not kept") == 1


def write_estimate(task, log):
    """Work of a test: write a file that says what made it."""
    note(log, task.item.name)
    task.hash_input(task.item)
    row = {"samples": 2, "sd": float("nan")}
    made = Estimate(np.array([0, 1]), "cf", q_nb=np.tile([1.0, 0, 0, 0], (2, 1)))
    write(target_of(task.item), made, origin=task.make_origin(row))
    return row


def target_of(path: Path) -> Path:
    return path.with_suffix(".estimate.mcap")


def run_files(paths, log, keeping=REUSE):
    def decide_file(path):
        return Deciding((path,), {}, target_of(path))

    return run_kept(
        partial(write_estimate, log=log), paths, decide_file, LOCAL, keeping, "estimate", dict, here_up_to=9
    )


def test_a_file_that_says_what_made_it_is_kept_without_any_folder_of_results(tmp_path, log):
    paths = make_files(tmp_path / "in", "a", "b")
    run_files(paths, log, Keeping(results=tmp_path / "one"))
    again = run_files(paths, log, Keeping(results=tmp_path / "two"))
    assert [one.kept for one in again] == [True, True]
    assert again[0].value["samples"] == 2
    assert np.isnan(again[0].value["sd"])
    assert not (tmp_path / "one").exists()


@pytest.mark.parametrize("damage", ["removed", "one bit", "cut", "of another input"])
def test_a_file_that_is_not_what_was_made_is_made_anew(tmp_path, log, damage):
    paths = make_files(tmp_path / "in", "a", "b")
    run_files(paths, log)
    file = target_of(paths[0])
    content = bytearray(file.read_bytes())
    if damage == "removed":
        file.unlink()
    elif damage == "one bit":
        content[len(content) // 2] ^= 1
        file.write_bytes(content)
    elif damage == "cut":
        file.write_bytes(content[: len(content) * 2 // 3])
    else:
        shutil.copy(target_of(paths[1]), file)
    assert [one.kept for one in run_files(paths, log)] == [False, True]
    assert read_origin(file)["key"] != read_origin(target_of(paths[1]))["key"]


def test_an_input_that_is_replaced_meanwhile_is_refused(tmp_path, log):
    def replace_first(task):
        task.item.write_text("another")
        task.hash_input(task.item)

    paths = make_files(tmp_path / "in", "a")
    (outcome,) = run_kept(replace_first, paths, decide, LOCAL, REUSE, "measure", Figures)
    assert "was replaced while it was worked on" in outcome.error
    paths[0].write_text("a")
    assert not run(paths, log)[0].kept


@pytest.mark.parametrize("change", ["replaced", "overwritten", "overwritten, with its old times"])
def test_an_input_that_lay_there_for_long_is_hashed_again_only_where_it_may_have_changed(
    tmp_path, log, monkeypatch, change
):
    """The stamp of a file that nothing touched stands for its content; every change of the content changes it."""
    (path,) = make_files(tmp_path / "in", "a")
    monkeypatch.setattr(kept, "_SETTLED_NS", 0)
    hashed = []
    monkeypatch.setattr(kept, "sha256", lambda one: (hashed.append(one), sha256(one))[1])

    def change_it(task):
        task.hash_input(task.item)
        before = task.item.stat()
        if change == "replaced":
            other = task.item.with_name("other")
            other.write_text("b")
            os.replace(other, task.item)
        else:
            time.sleep(0.02)  # a tick of the system's clock
            task.item.write_text("b")
        if "old times" in change:
            os.utime(task.item, ns=(before.st_atime_ns, before.st_mtime_ns))
        assert hashed == [path], "once, before the work"
        task.hash_input(task.item)

    (outcome,) = run_kept(change_it, [path], decide, LOCAL, REUSE, "measure", Figures, here_up_to=1)
    assert "was replaced while it was worked on" in outcome.error


def test_an_input_that_was_changed_a_moment_ago_is_hashed_again(tmp_path, log, monkeypatch):
    """Another change within the same tick of the file system's clock would not show in its times."""
    (path,) = make_files(tmp_path / "in", "a")
    hashed = []
    monkeypatch.setattr(kept, "sha256", lambda one: (hashed.append(one), sha256(one))[1])
    run_kept(lambda task: task.hash_input(task.item), [path], decide, LOCAL, REUSE, "measure", str, here_up_to=1)
    assert hashed == [path, path]


@pytest.mark.slow
def test_the_pool_keeps_results_as_they_arrive(tmp_path, log):
    """A run that is stopped in the middle has kept what was done before."""
    paths = make_files(tmp_path / "in", *"abcd")

    def stop_after_two(task):
        if len(lines(log)) == 2:
            raise KeyboardInterrupt
        return measure(task, log=log)

    with pytest.raises(KeyboardInterrupt):
        run_kept(stop_after_two, paths, decide, LOCAL, REUSE, "measure", Figures, here_up_to=9)
    assert [one.kept for one in run(paths, log)] == [True, True, False, False]
    assert run_kept(partial(measure, log=log), paths, decide, Workers(2), Keeping(force=True), "measure", Figures)
