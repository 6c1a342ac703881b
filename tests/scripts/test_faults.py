"""The program behind `make faults`, with few kills: files stay whole, what is refused is refused in one line."""

import pytest
from faults import find_faults_of, format_page, kill_writers
from kills import Tally
from surroundings import Case, Places, forbid_reading, forbid_writing, limit_size, stall_reader
from writers import WRITERS, make_inputs

CHEAP = ("cut", "export ../inputs/hand.cf", "archive add")
KILLED = [k for k, writer in enumerate(WRITERS) if writer.words.startswith(CHEAP)]


@pytest.fixture(scope="module")
def scratch(tmp_path_factory):
    folder = tmp_path_factory.mktemp("faults")
    make_inputs(folder / "inputs")
    return folder


@pytest.mark.slow
def test_killed_commands_leave_whole_files_and_no_debris(scratch):
    tallies = kill_writers(scratch, 9, KILLED)
    assert sum(tally.kills for tally in tallies) >= 5, "the kills come after the ends of the commands"
    assert find_faults_of(tallies, []) == []


@pytest.mark.slow
@pytest.mark.parametrize("make", [forbid_reading, forbid_writing, limit_size, stall_reader])
def test_what_is_taken_away_is_said_in_one_line(scratch, make):
    assert make(Places(scratch)).examples == ()


def test_the_page_names_what_was_not_as_wanted():
    tally = Tally(WRITERS[0], kills=3, hits=1)
    tally.blame("broken", "out/a.mcap")
    page = format_page([tally], [Case("the disk is full", "one line", "0 of 1", False, ("`stillpoint x`: silence",))])
    assert "| 3 | 1 | 1 | 0 | 0 | 0 | 0 | 0 |" in page
    assert "broken: out/a.mcap" in page
    assert "not clean" in page
    assert "`stillpoint x`: silence" in page
