"""Progress in a log: a line now and then while the work lasts, and none after it."""

import time

from stillpoint.scripts.shared import progress


def test_a_log_gets_a_line_while_the_work_lasts(monkeypatch, capsys) -> None:
    monkeypatch.setattr(progress, "LOG_EVERY_S", 0.05)
    printed, latest_s = "", time.monotonic() + 60.0  # for a busy machine, whose thread waits for its turn
    with progress.show_progress("reference", 3) as count:
        count()
        while "1 of 3" not in printed and time.monotonic() < latest_s:
            time.sleep(0.01)
            printed += capsys.readouterr().err
    assert "reference: 1 of 3 done after " in printed.splitlines()[-1]
    capsys.readouterr()
    time.sleep(0.15)
    assert capsys.readouterr().err == ""


def test_quick_work_prints_nothing(capsys) -> None:
    assert list(progress.track([1, 2, 3], "score")) == [1, 2, 3]
    assert capsys.readouterr() == ("", "")


def test_the_lines_end_when_the_work_fails(monkeypatch, capsys) -> None:
    monkeypatch.setattr(progress, "LOG_EVERY_S", 0.02)
    try:
        for _ in progress.track([1], "score"):
            raise ValueError
    except ValueError:
        pass
    capsys.readouterr()
    time.sleep(0.1)
    assert capsys.readouterr().err == ""
