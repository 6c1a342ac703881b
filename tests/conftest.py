"""Fixtures of all tests, the choice of real data, and the order of files."""

import os
import signal
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings
from known import Known, known_recording

# The same examples on every machine and in every run: what is green here is green there. `make properties`
# draws new ones.
settings.register_profile("stillpoint", deadline=None, max_examples=50, derandomize=True)
settings.register_profile("draw", deadline=None, max_examples=1000)
settings.load_profile(os.environ.get("STILLPOINT_HYPOTHESIS", "stillpoint"))


@pytest.fixture(scope="session")
def _results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("results")


@pytest.fixture(autouse=True)
def _own_results(_results: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the results of verbs in a folder of each test, so that none sees those of another."""
    monkeypatch.setenv("STILLPOINT_RESULTS", str(_results / str(abs(hash(request.node.nodeid)))))


@pytest.fixture(autouse=True)
def _little_ink(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw the pictures of a page but do not write them as SVG, which takes half of the time of a page.

    Tests that look at the pictures carry the marker ``ink``.
    """
    if request.node.get_closest_marker("ink") is None:
        monkeypatch.setattr("stillpoint.scoring.report.pictures._render_svg", lambda figure, title, name: "<svg></svg>")


@pytest.fixture(scope="session", autouse=True)
def _small_batches_here() -> None:
    """Let a batch that is not told how many processes to take work in this one.

    A process imports for more than a second, a small input takes less. How a batch uses processes is tested in
    ``tests/scripts/test_jobs.py``, and wherever a test asks for some.
    """
    from stillpoint.scripts.shared import jobs

    jobs.HERE_UP_TO = 100


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder named by STILLPOINT_DATA (with broad/, tyrex/, bench/, disc/); the test is skipped without it."""
    folder = os.environ.get("STILLPOINT_DATA")
    if not folder:
        pytest.skip("STILLPOINT_DATA does not name a folder of real recordings")
    if not Path(folder).is_dir():
        pytest.fail(f"STILLPOINT_DATA={folder} is not a folder")
    return Path(folder)


@pytest.fixture(scope="session")
def known() -> Known:
    """A recording for importers to give back."""
    return known_recording()


@pytest.fixture(scope="session")
def call() -> Callable[..., int]:
    """The command in this process: words in, exit code out."""
    from stillpoint.scripts.main import main
    from stillpoint.scripts.shared import progress

    progress.LOG_EVERY_S = 3600.0  # no lines of progress among what tests read, however slow the machine

    def words_to_code(*words: object) -> int:
        with pytest.raises(SystemExit) as stopped:
            main([str(word) for word in words])
        assert isinstance(stopped.value.code, int)
        return stopped.value.code

    return words_to_code


def pytest_configure() -> None:
    """Take Ctrl-C back: what a shell starts in the background ignores it, and so would all that tests start."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Every test that takes ``data_dir`` can be chosen with ``-m real_data``; files with slow tests come first.

    A worker takes whole files: were a long one the last, one worker would end alone.
    """
    for item in items:
        if "data_dir" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.real_data)
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])
