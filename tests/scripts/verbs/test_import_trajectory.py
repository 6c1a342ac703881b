"""``import trajectory`` puts a foreign attitude beside its recording under a label."""

import numpy as np
import pytest

from stillpoint.datasets import read, write
from stillpoint.datasets.importers.trajectories import format_tum
from stillpoint.datasets.simulate import simulate
from stillpoint.studies.leaderboard.files import find_files


@pytest.fixture(scope="module")
def made():
    return simulate("phone-3", minutes=1.5)


@pytest.fixture
def folder(tmp_path, made):
    write(tmp_path / "run.mcap", made)
    (tmp_path / "other.txt").write_text(format_tum(made.truth.t_ns, made.truth.q_nb))
    return tmp_path


@pytest.mark.slow
def test_attitude_lands_beside_the_recording_and_is_found(call, folder, made):
    assert call("import", "trajectory", folder / "other.txt", "--recording", folder / "run.mcap", "--name", "mine") == 0
    kept = read(folder / "run.mine.estimate.mcap")
    assert (kept.name, kept.recording) == ("mine", made.name)
    np.testing.assert_allclose(kept.q_nb, made.truth.q_nb, atol=1e-9)
    assert find_files(folder / "run.mcap") == {"mine": folder / "run.mine.estimate.mcap"}


def test_another_clock_is_refused(call, capsys, folder, made):
    (folder / "other.txt").write_text(format_tum(made.truth.t_ns + 10**12, made.truth.q_nb))
    assert call("import", "trajectory", folder / "other.txt", "--recording", folder / "run.mcap", "--name", "mine") == 2
    assert "bring both to one clock" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["ekf", "a.b", "", "a/b"])
def test_name_that_is_taken_or_no_name_is_refused(call, capsys, folder, name):
    assert call("import", "trajectory", folder / "other.txt", "--recording", folder / "run.mcap", "--name", name) == 2
    assert "--name" in capsys.readouterr().err


def test_inverse_rotation_is_turned_back(call, folder, made):
    conjugate = made.truth.q_nb * [1, -1, -1, -1]
    (folder / "other.txt").write_text(format_tum(made.truth.t_ns, conjugate))
    words = ["--recording", folder / "run.mcap", "--name", "mine", "--inverse"]
    assert call("import", "trajectory", folder / "other.txt", *words) == 0
    dots = np.abs((read(folder / "run.mine.estimate.mcap").q_nb * made.truth.q_nb).sum(axis=1))
    np.testing.assert_allclose(dots, 1, atol=1e-9)
