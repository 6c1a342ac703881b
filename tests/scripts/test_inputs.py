from pathlib import Path

import pytest

from stillpoint.datasets.errors import BadParameter
from stillpoint.scripts.shared import inputs


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("b.mcap", "a.mcap", "a.reference.mcap", "a.vqf.estimate.mcap", "notes.txt", ".half.mcap"):
        (tmp_path / name).touch()
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "c.mcap").touch()
    (tmp_path / "empty").mkdir()
    return tmp_path


def names(paths: list[Path]) -> list[str]:
    return [path.name for path in paths]


def test_a_folder_is_sorted_by_kind_and_hidden_files_are_left_out(folder):
    assert names(inputs.find_recordings([folder])) == ["a.mcap", "b.mcap", "c.mcap"]
    assert names(inputs.find_references([folder])) == ["a.reference.mcap"]
    assert names(inputs.find_estimates([folder])) == ["a.vqf.estimate.mcap"]


def test_globs_keep_the_order_of_the_arguments_and_name_each_file_once(folder):
    found = inputs.find_recordings([folder / "b.mcap", str(folder / "*.mcap"), folder])
    assert names(found) == ["b.mcap", "a.mcap", "c.mcap"]


def test_a_file_whose_name_holds_glob_signs_is_taken_as_it_is(folder):
    odd = folder / "run[1].mcap"
    odd.touch()
    assert inputs.find_recordings([odd]) == [odd]


def test_files_of_other_kinds_that_a_shell_makes_of_a_glob_are_left_out_and_counted(folder, capsys):
    every = sorted(folder.glob("*.mcap"))
    assert names(inputs.find_recordings(every)) == [".half.mcap", "a.mcap", "b.mcap"]
    assert capsys.readouterr().err == "2 estimates and references among the named files are left out\n"
    assert names(inputs.find_references(every)) == ["a.reference.mcap"]


@pytest.mark.parametrize(
    ("argument", "said"),
    [
        ("nothing.mcap", "no such file"),
        ("*.bag", "no such file"),
        ("notes.txt", "stillpoint import"),
        ("*.txt", "no MCAP file among them"),
        ("empty", "holds no MCAP file"),
        ("a.reference.mcap", "is a reference"),
        ("deep", "holds no reference"),
    ],
)
def test_each_wrong_input_gives_one_line_error_that_names_it(folder, argument, said):
    wanted = inputs.find_references if argument == "deep" else inputs.find_recordings
    with pytest.raises(BadParameter, match=said) as caught:
        wanted([folder / argument])
    assert argument in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_argument_is_refused():
    with pytest.raises(BadParameter, match="no input"):
        inputs.find_recordings([])


def test_the_output_folder_is_made_and_a_file_in_its_place_is_refused(folder):
    assert inputs.make_output_dir(folder / "x" / "y").is_dir()
    with pytest.raises(BadParameter, match="is a file"):
        inputs.make_output_dir(folder / "a.mcap")
    with pytest.raises(BadParameter, match="cannot be made"):
        inputs.make_output_dir(folder / "a.mcap" / "below")
