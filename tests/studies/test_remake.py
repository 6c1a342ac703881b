"""What is kept is made again from its recording with its own settings, and a change is found."""

from dataclasses import replace

import numpy as np
import pytest
from known import known_recording

from stillpoint.datasets import Recording, read, write
from stillpoint.datasets.archive import create_archive
from stillpoint.datasets.calibration.apply import apply_calibration, load_calibration
from stillpoint.datasets.calibration.device import DeviceFile, write_device
from stillpoint.datasets.frames import quaternion, rotation
from stillpoint.datasets.mcap.store import sha256
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.studies.remake import compute_largest_difference_rad, draw_jobs, flatten, remake


@pytest.fixture
def archive(tmp_path):
    """A recording with two estimates, of which one has settings of its own."""
    known = known_recording()
    recording = Recording.from_arrays("known", known.t_s, known.gyro_b_radps, known.accel_b_mps2, known.mag_b_ut)
    write(tmp_path / "known.mcap", recording)
    made_from = {"known.mcap": sha256(tmp_path / "known.mcap")}
    files = [tmp_path / "known.mcap"]
    for name, params in {"cf": {"omega0_radps": 0.5}, "cf-fixed": {}}.items():
        made = replace(estimate(recording, name, params), made_from=made_from)
        files.append(tmp_path / f"known.{name}.estimate.mcap")
        write(files[-1], made)
    with create_archive(tmp_path / "archive") as opened:
        list(opened.add(files))
        yield opened


def test_estimates_come_out_the_same(archive):
    jobs, reasons = draw_jobs(archive, None, 0)
    assert reasons == {}
    assert [remake(job).difference_rad for job in jobs] == [0.0, 0.0]


@pytest.mark.slow
def test_what_was_asked_beside_the_parameters_is_asked_again(tmp_path):
    """A full scale that leaves samples out, the course as heading with its own setting, and a calibration by file."""
    recording = simulate("car", 0, minutes=1.0)
    write(tmp_path / "drive.mcap", recording)
    made_from = {"drive.mcap": sha256(tmp_path / "drive.mcap")}
    device = DeviceFile("", 1.01 * np.eye(3), np.zeros((3, 3)), np.eye(3), np.zeros((3, 3)), *np.zeros((2, 3)), (), ())
    write_device(tmp_path / "imu.calibration.toml", device)
    known = load_calibration(tmp_path / "imu.calibration.toml")
    files = [tmp_path / "drive.mcap", tmp_path / "imu.calibration.toml"]
    for name, asked, calibration in (
        ("cut", {"ranges": {"accel_mps2": 9.9}}, None),
        ("course", {"heading": "gps-course", "heading_params": {"least_speed_mps": 5.0}}, None),
        ("calibrated", {}, known),
    ):
        used = recording if calibration is None else apply_calibration(recording, calibration)
        made = estimate(used, "cf", **asked)
        if calibration is not None:
            made = replace(made, diagnostics={**made.diagnostics, "calibrated_by": calibration.name})
        parents = made_from | ({} if calibration is None else {calibration.name: calibration.sha256})
        files.append(tmp_path / f"{name}.cf.estimate.mcap")
        write(files[-1], replace(made, made_from=parents))
    plain = estimate(recording, "cf")
    assert min(compute_largest_difference_rad(plain, read(file)) for file in files[2:]) > 1e-3  # each of them matters
    with create_archive(tmp_path / "archive") as opened:
        list(opened.add(files))
        jobs, reasons = draw_jobs(opened, None, 0)
        assert reasons == {}
        assert [remake(job).difference_rad for job in jobs] == [0.0, 0.0, 0.0]


def test_an_estimate_that_was_changed_is_found(archive, tmp_path):
    kept = read(archive.find_path(archive.resolve("known.cf.estimate.mcap")))
    turned = rotation(kept.q_nb) * rotation(np.array([1.0, 1e-6, 0, 0]) / np.sqrt(1 + 1e-12))
    write(tmp_path / "changed.estimate.mcap", replace(kept, q_nb=quaternion(turned)))
    list(archive.add([tmp_path / "changed.estimate.mcap"]))
    jobs, _ = draw_jobs(archive, None, 0)
    found = {job.file_name: remake(job).difference_rad for job in jobs}
    assert found["changed.estimate.mcap"] == pytest.approx(2e-6, rel=1e-3)


def test_what_cannot_be_made_again_is_said(archive, tmp_path):
    kept = read(archive.find_path(archive.resolve("known.cf.estimate.mcap")))
    write(tmp_path / "free.estimate.mcap", replace(kept, made_from={}))
    list(archive.add([tmp_path / "free.estimate.mcap"]))
    _, reasons = draw_jobs(archive, None, 0)
    assert list(reasons) == ["free.estimate.mcap"]


def test_a_draw_is_repeatable_and_of_the_size_asked_for(archive):
    assert [draw_jobs(archive, 1, 5)[0] for _ in range(2)] == [draw_jobs(archive, 1, 5)[0]] * 2
    assert len(draw_jobs(archive, 1, 5)[0]) == 1


def test_other_times_are_no_match(archive):
    kept = read(archive.find_path(archive.resolve("known.cf.estimate.mcap")))
    assert compute_largest_difference_rad(kept, replace(kept, t_ns=kept.t_ns + 1)) == np.inf


def test_settings_in_settings_become_dotted_names():
    assert flatten({"a": 1, "b": {"c": {"d": 2}, "e": 3}}) == {"a": 1, "b.c.d": 2, "b.e": 3}
