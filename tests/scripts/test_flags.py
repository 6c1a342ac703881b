"""One set of flags: the same name means the same thing at every verb."""

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin

import pytest
from cyclopts import App

from stillpoint.scripts.main import app

ALONE = {
    "join": "makes one recording of all of its files",
    "plot": "draws one figure",
    "view": "shows one scene",
    "spin identify": "finds one set of variances over all of its files",
    "archive add": "copies, and moves the copies into the archive in one transaction",
}


def list_verbs(parent: App, words: tuple[str, ...] = ()) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield every verb, subcommands too, with its arguments by each of their names."""
    for word in (name for name in parent if not name.startswith("-")):
        yield from list_verbs(parent[word], (*words, word))
    if parent.default_command is not None and words:
        arguments = parent.assemble_argument_collection()
        yield " ".join(words), {name: one for one in arguments for name in one.names}


VERBS = dict(list_verbs(app()))


def takes_many_files(arguments: dict[str, Any]) -> bool:
    def holds_paths(hint: Any) -> bool:
        return get_origin(hint) in (list, tuple) and Path in get_args(hint)

    return any(not name.startswith("-") and holds_paths(one.hint) for name, one in arguments.items())


MANY = sorted(verb for verb, arguments in VERBS.items() if takes_many_files(arguments))


def test_the_walk_finds_verbs_and_those_of_many_files():
    assert {"import", "leaderboard", "archive add", "experiment phone-1"} <= set(VERBS)
    assert {"import", "doctor", "reference", "estimate", "score", "tune", "recover"} <= set(MANY)


@pytest.mark.parametrize("verb", MANY)
def test_a_verb_of_many_files_takes_jobs(verb):
    assert ("--jobs" in VERBS[verb]) is (verb not in ALONE), ALONE.get(verb, "work on files side by side needs --jobs")


@pytest.mark.parametrize("verb", ["leaderboard", "fetch", "experiment phone-1", "archive verify"])
def test_other_verbs_that_work_on_many_recordings_take_jobs_too(verb):
    assert "--jobs" in VERBS[verb]


@pytest.mark.parametrize("verb", ["doctor", "import"])
def test_remedies_are_applied_by_the_same_flags(verb):
    assert {"--repair", "--skip"} <= set(VERBS[verb])


def test_a_letter_stands_for_one_flag():
    long_names = defaultdict(set)
    for arguments in VERBS.values():
        for name, one in arguments.items():
            if name.startswith("-") and not name.startswith("--"):
                long_names[name].add(one.names[0])
    assert long_names == {"-o": {"--out"}, "-e": {"--estimators"}, "-c": {"--study"}}


def test_where_results_go_and_what_runs_has_one_name():
    for verb, arguments in VERBS.items():
        for name, one in arguments.items():
            assert name not in ("--output", "--output-dir", "--workers", "--processes", "--fix"), verb
            if name in ("--out", "--estimators"):
                assert one.names[1] == {"--out": "-o", "--estimators": "-e"}[name], verb


@pytest.mark.parametrize("flag", ["--align", "--frame", "--columns", "--jobs", "--json", "--scheduler", "--set"])
def test_a_flag_takes_the_same_words_at_every_verb(flag):
    # --frame of import and import trajectory is a frame_id of ROS and the world of a file, not that of Euler angles.
    verbs = {verb: a for verb, a in VERBS.items() if flag != "--frame" or not verb.startswith("import")}
    hints = {verb: without_none(arguments[flag].hint) for verb, arguments in verbs.items() if flag in arguments}
    assert len(hints) > 1
    assert len(set(hints.values())) == 1, hints


def without_none(hint: Any) -> Any:
    """Return the type of a flag that is not None: whether there is a default is up to the verb."""
    if get_origin(hint) not in (Union, UnionType):
        return hint
    (kind,) = (one for one in get_args(hint) if one is not type(None))
    return kind
