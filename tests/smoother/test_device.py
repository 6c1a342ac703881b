"""Joint calibration of a device: the pooled matrices, what is counted how often, and that two devices are refused."""

from dataclasses import replace

import numpy as np
import pytest

from stillpoint.datasets import BadFile, BadParameter, Calibration, Imu, read, write
from stillpoint.datasets.calibration.apply import load_calibration
from stillpoint.datasets.calibration.device import DeviceFile, read_device, write_device
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.trajectory import Reference
from stillpoint.scoring import score
from stillpoint.smoother.device import BIAS_SD_MPS2, calibrate_device

PRIOR_SD = 0.005


def made(seed, device, bias=(0.02, -0.01, 0.03), data_sd=1e-3, seen=18):
    """A reference whose calibration is a draw of its own posterior: data of sd ``data_sd`` on the first elements."""
    draw = np.random.default_rng(seed)
    information = np.zeros(18)
    information[:seen] = 1 / data_sd**2
    covariance = np.diag(1 / (information + 1 / PRIOR_SD**2))
    data = device + draw.normal(size=18) * data_sd
    mean = covariance @ (information * data)
    calibration = Calibration(
        gyro_matrix=np.eye(3) + mean[9:].reshape(3, 3),
        gyro_matrix_sd=np.sqrt(np.diagonal(covariance))[9:].reshape(3, 3),
        accel_matrix=np.eye(3) + mean[:9].reshape(3, 3),
        accel_matrix_sd=np.sqrt(np.diagonal(covariance))[:9].reshape(3, 3),
        accel_bias_b_mps2=np.array(bias) + draw.normal(size=3) * BIAS_SD_MPS2,
        matrix_covariance=covariance,
    )
    return Reference(
        t_ns=np.array([0, 10]),
        q_nb=np.array([[1.0, 0, 0, 0]] * 2),
        cov_b_rad2=np.array([np.eye(3)] * 2) * 1e-4,
        gyro_bias_b_radps=np.zeros((2, 3)),
        method="graph",
        name=f"run{seed}",
        calibration=calibration,
        diagnostics={"gyro_matrix_prior_sd": PRIOR_SD, "accel_matrix_prior_sd": PRIOR_SD},
    )


@pytest.fixture
def device():
    return np.random.default_rng(9).normal(size=18) * 0.003


def symmetric(device):
    accel, gyro = device[:9].reshape(3, 3), device[9:].reshape(3, 3)
    return (gyro + gyro.T) / 2, (accel + accel.T) / 2


def test_the_pooled_matrices_are_those_of_the_device_within_their_sd(device):
    found = calibrate_device([made(seed, device) for seed in range(8)])
    gyro, accel = symmetric(device)
    off = np.stack([found.gyro_matrix - np.eye(3) - gyro, found.accel_matrix - np.eye(3) - accel])
    sd = np.stack([found.gyro_matrix_sd, found.accel_matrix_sd])
    assert np.abs(off / sd).max() < 4
    assert np.sqrt(np.mean((off / sd) ** 2)) < 1.6
    assert np.array_equal(found.gyro_matrix, found.gyro_matrix.T)


def test_the_data_of_each_recording_counts_once_and_the_prior_once(device):
    """sd^-2 of a diagonal element is that of the prior and of the data of all recordings."""
    found = calibrate_device([made(seed, device) for seed in range(4)])
    assert found.gyro_matrix_sd[0, 0] ** -2 == pytest.approx(PRIOR_SD**-2 + 4 * 1e-3**-2, rel=1e-6)
    hidden = calibrate_device([made(seed, device, seen=9) for seed in range(4)])
    assert hidden.gyro_matrix_sd[0, 0] == pytest.approx(PRIOR_SD, rel=1e-6)
    assert hidden.gyro_matrix[0, 0] == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_recordings_of_one_device_are_accepted(seed):
    device = np.random.default_rng(seed).normal(size=18) * 0.003
    found = calibrate_device([made(20 * seed + k, device) for k in range(6)])
    assert 0 < found.split < found.split_of_one


@pytest.mark.parametrize("what", ["gyro", "bias"])
def test_two_devices_are_refused_and_named(device, what):
    """As in BROAD: gyro yz -0.16 % against +0.14 %, or the accelerometer's z bias 0.1 m/s^2 apart."""
    other = device.copy()
    bias = [0.02, -0.01, 0.03]
    if what == "gyro":
        other[[9 + 5, 9 + 7]] += 0.006
    else:
        bias[2] += 0.1
    first = [made(seed, device) for seed in (1, 3, 5)]
    second = [made(seed, other, bias) for seed in (2, 4)]
    with pytest.raises(BadParameter) as refused:
        calibrate_device([first[0], second[0], first[1], second[1], first[2]])
    text = str(refused.value)
    assert ("gyro_yz" if what == "gyro" else "accel_bias_z") in text
    assert "run1, run3, run5" in text
    assert "run2, run4" in text


def test_one_recording_or_none_with_a_covariance_is_refused(device):
    one = made(1, device)
    with pytest.raises(BadParameter, match="needs two recordings"):
        calibrate_device([one])
    old = replace(one, calibration=replace(one.calibration, matrix_covariance=None))
    with pytest.raises(BadParameter, match="has no covariance of its calibration; make it again"):
        calibrate_device([one, old])


@pytest.fixture
def calibrated(tmp_path, device):
    for seed in range(3):
        write(tmp_path / f"run{seed}.reference.mcap", made(seed, device))
    return sorted(tmp_path.glob("*.reference.mcap"))


@pytest.mark.slow
def test_the_command_writes_a_file_that_is_read_back_exactly(call, tmp_path, calibrated, device):
    out, plot = tmp_path / "phone.calibration.toml", tmp_path / "drift.svg"
    assert call("calibrate", *calibrated, "-o", out, "--plot", plot) == 0
    kept = read_device(out)
    found = calibrate_device([made(seed, device) for seed in range(3)])
    assert np.array_equal(kept.gyro_matrix, found.gyro_matrix)
    assert np.array_equal(kept.accel_bias_b_mps2, found.accel_bias_b_mps2)
    assert [one["name"] for one in kept.drift] == ["run0", "run1", "run2"]
    assert set(kept.made_from) == {file.name for file in calibrated}
    assert plot.read_text().lstrip().startswith("<?xml")
    known = load_calibration(out)
    assert np.array_equal(known.calibration.accel_matrix, found.accel_matrix)
    assert known.gyro_bias_b_radps is None
    again = load_calibration(out.with_suffix(".mcap"))
    assert np.array_equal(again.calibration.accel_matrix, found.accel_matrix)
    assert again.made_from == known.made_from


@pytest.mark.slow
def test_a_device_is_calibrated_on_some_recordings_and_used_on_another(call, tmp_path):
    """Gyro scales 1.5 % off: the pooled matrix is the inverse within 3 sd, a good sensor's prior fits the rest."""
    scales = np.array([1.015, 0.985, 1.01])
    for seed in range(4):
        recording = simulate("phone-3", seed=40 + seed, minutes=1.6)
        imu = recording.imu
        raw = replace(recording, imu=Imu(imu.t_ns, imu.gyro_b_radps * scales, imu.accel_b_mps2))
        write(tmp_path / f"run{seed}.mcap", raw)
    files, out = sorted(tmp_path.glob("run*.mcap")), tmp_path / "phone.calibration.toml"
    assert call("calibrate", *files[:3], "-o", out) == 0
    found = load_calibration(out).calibration
    off = np.abs(np.diagonal(found.gyro_matrix) - 1 / scales)
    assert (off < 3 * np.diagonal(found.gyro_matrix_sd)).all()
    assert off.max() < 0.008  # half of what it was
    known = read_reference_with(call, files[3], tmp_path / "known", ("--calibration", out.with_suffix(".mcap")))
    assert known.diagnostics["gyro_matrix_prior_sd"] == 0.005
    scored = score(known, read(files[3]).truth, "heading")
    assert scored.total_rmse_deg < 0.6
    assert scored.coverage95 > 0.85
    assert np.abs(np.diagonal(known.calibration.gyro_matrix) - 1 / scales).max() < 0.008


def read_reference_with(call, file, folder, options):
    assert call("reference", file, *options, "-o", folder) == 0
    return read(folder / f"{file.stem}.reference.mcap")


def test_names_are_data(tmp_path):
    """Quotes, newlines and other signs in a file's name come back as they are."""
    name = 'a "quoted"\\name\nwith\ttabs\x7f'
    eye = np.eye(3)
    device = DeviceFile(name, eye, eye, eye, eye, np.zeros(3), np.ones(3), ("",), (float("nan"),), {name: "00"}, ())
    write_device(tmp_path / "x.calibration.toml", device)
    back = read_device(tmp_path / "x.calibration.toml")
    assert back.sensor == name
    assert dict(back.made_from) == {name: "00"}


@pytest.mark.parametrize("text", ["", "kind = 'other'", "kind = 'device calibration'", "[[[", "\x00"])
def test_a_file_that_is_no_calibration_is_refused(tmp_path, text):
    path = tmp_path / "x.calibration.toml"
    path.write_text(text)
    with pytest.raises(BadFile, match="is not a calibration of a device"):
        load_calibration(path)
