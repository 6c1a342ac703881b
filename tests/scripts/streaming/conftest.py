"""The stream in this process."""

import io
from collections.abc import Callable

import pytest


@pytest.fixture
def feed(
    call: Callable[..., int], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """``stillpoint stream`` with a text as its standard input: exit code, output and errors."""

    def run(text: str, *options: object) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
        capsys.readouterr()
        return call("stream", *options), *capsys.readouterr()

    return run
