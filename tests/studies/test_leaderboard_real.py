"""Real phones and BROAD: what calibration does to heading, and whether the graph ranks as optical truth does."""

from dataclasses import replace

import pytest

from stillpoint.datasets import write
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.mcap.store import sha256
from stillpoint.studies.fidelity import measure_fidelity
from stillpoint.studies.leaderboard import leaderboard


@pytest.fixture(scope="module")
def phones(data_dir, tmp_path_factory):
    """Two trials with the phone's own attitude beside them."""
    place = tmp_path_factory.mktemp("phones")
    for trial in ("android/Guillaume_Nexus5_NoDist_AR", "ios/Guillaume_iPhone5_NoDist_Texting"):
        for imported in IMPORTERS["tyrex"].read_all(data_dir / "tyrex" / trial):
            name = imported.recording.name
            file = place / f"{name}.mcap"
            write(file, imported.recording)
            for estimate in imported.estimates:  # with the hash of the recording, as the verb import writes it
                made_from = {**estimate.made_from, file.name: sha256(file)}
                write(place / f"{name}.{estimate.name}.estimate.mcap", replace(estimate, made_from=made_from))
    return sorted(file for file in place.glob("*.mcap") if not file.name.endswith(".estimate.mcap"))


@pytest.mark.slow
def test_calibration_at_least_halves_the_heading_error_of_phones(phones, tmp_path):
    board = leaderboard(phones, ["gyro", "vqf"], tmp_path, calibration=("none", "reference"))
    heading = {(row.estimator, row.calibration): row.heading_rmse_deg.typical for row in board.first_rows}
    for name in ("gyro", "vqf"):
        assert heading[name, "reference"] < heading[name, "none"] / 2
    assert [(table.ranked_by, table.inputs) for table in board.tables] == [
        ("total", "calibrated by the reference"),
        ("inclination", "as recorded"),
    ]


@pytest.mark.slow
def test_device_is_an_estimator_and_motions_are_known(phones, tmp_path):
    board = leaderboard(phones, ["gyro"], tmp_path)
    row = next(row for row in board.tables[0].rows if row.estimator == "device")
    assert row.failed == 0
    assert row.inclination_rmse_deg.worst < 2, "the phones' own filters hold tilt within 1.5 deg on these trials"
    assert {source.motion for source in board.sources} == {"undisturbed AR", "undisturbed Texting"}


@pytest.mark.slow
def test_graph_ranks_estimators_as_optical_truth_does(data_dir, tmp_path):
    for number in ("02", "08", "21"):
        path = next((data_dir / "broad").glob(f"{number}_*.mat"))
        recording = next(iter(IMPORTERS["broad"].read_all(path))).recording
        write(tmp_path / f"{recording.name}.mcap", recording)
    files = sorted(tmp_path.glob("*.mcap"))
    found = measure_fidelity(files, ["gyro", "acc", "cf", "vqf", "offline-vqf"], tmp_path / "out", judges=["graph"])
    judge = found.judges[0]
    assert judge.tau_pooled > 0.9
    assert judge.wrong_verdicts == 0
