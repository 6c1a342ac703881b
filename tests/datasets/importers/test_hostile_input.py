"""Inputs that are damaged or made to harm: one line of error, and no more memory than they deserve."""

import struct
import subprocess
import sys
import traceback
import tracemalloc
import zipfile
import zlib
from collections import Counter

import fuzz
import h5py
import numpy as np
import pytest
import scipy.io
from fuzz_seeds import list_seeds

from stillpoint.datasets import BadSource
from stillpoint.datasets.files.limits import LARGE, LARGEST_MEMBER, limit_chunk
from stillpoint.datasets.importers import broad
from stillpoint.datasets.importers import files as importer_files
from stillpoint.datasets.importers.csv_log import CsvOptions
from stillpoint.datasets.importers.matlab import load_mat
from stillpoint.datasets.importers.table import IMPORTERS

LOG = CsvOptions(time="t:s", gyro="gx,gy,gz:rad/s", accel="ax,ay,az:m/s^2")


def refuse(kind: str, source, *said: str, options=None) -> BadSource:
    with pytest.raises(BadSource) as caught:
        list(IMPORTERS[kind](source, options))
    for word in said:
        assert word in str(caught.value), str(caught.value)
    assert "\n" not in str(caught.value)
    return caught.value


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the peak of memory is read from /proc")
def test_damaged_inputs_of_every_kind_give_a_recording_or_one_line():
    # The readers are forks: they would count the memory that earlier tests left in this process as their own.
    command = [sys.executable, fuzz.__file__, "--count", str(2 * len(list_seeds())), "--seed", "1"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert f"{2 * len(list_seeds())} inputs, 0 failures" in ended.stdout


def test_the_fuzzer_tells_failures_from_messages():
    assert fuzz.judge("message", "log.csv: is empty; export it again", 0) == ""
    assert fuzz.judge("traceback", "ValueError", 0) == "traceback"
    assert fuzz.judge("message", "two\nlines", 0)
    assert fuzz.judge("message", "fine", 600 << 20) == "memory"
    assert Counter(seed.kind for seed in list_seeds()).keys() >= set(IMPORTERS) - {"flatball", "ngimu"}


def test_a_failure_of_a_library_becomes_one_line_and_keeps_its_traceback(tmp_path, monkeypatch):
    def explode(*_, **__):
        raise AssertionError("first\nsecond")

    monkeypatch.setattr(broad, "load_mat", explode)
    (tmp_path / "x.mat").write_bytes(b"x")
    error = refuse("broad", tmp_path / "x.mat", "x.mat", "AssertionError: first second")
    assert "explode" in "".join(traceback.format_exception(error))


def test_a_column_whose_name_holds_a_line_break_is_quoted_on_one_line(tmp_path):
    (tmp_path / "log.csv").write_text('t,gx,gy,gz,ax,ay,"a\n\x1b[31mz"\n0,0,0,0,0,0,9.81\n')
    error = refuse("csv", tmp_path / "log.csv", "no column 'az'", "\\n", options=LOG)
    assert "\x1b" not in str(error)


def test_a_zip_that_claims_too_much_is_not_unpacked(tmp_path):
    file = tmp_path / "bomb.zip"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("Gyroscope.csv", "w") as out:
        for _ in range(40):
            out.write(bytes(1 << 20))
    data = bytearray(file.read_bytes())
    for signature, at in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):  # the claimed size, unpacked
        place = data.index(signature) + at
        data[place : place + 4] = struct.pack("<I", LARGEST_MEMBER + 1)
    file.write_bytes(data)
    tracemalloc.start()
    refuse("sensorlogger", file, "Gyroscope.csv claims 1073741825 bytes", "--large")
    assert tracemalloc.get_traced_memory()[1] < 10 << 20
    tracemalloc.stop()


@pytest.mark.slow
def test_a_small_zip_may_not_claim_hundreds_of_megabytes(tmp_path):
    file = tmp_path / "zeros.zip"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("Gyroscope.csv", "w") as out:
        for _ in range(100):
            out.write(b"0" * (1 << 20))
    tracemalloc.start()
    refuse("sensorlogger", file, "claims 104857600 bytes, unpacked, from 10", "--large")
    assert tracemalloc.get_traced_memory()[1] < 10 << 20
    tracemalloc.stop()


def test_a_zip_that_claims_too_little_is_refused(tmp_path):
    file = tmp_path / "bomb.zip"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("Gyroscope.csv", "0" * (8 << 20))
    data = bytearray(file.read_bytes())
    for signature, at in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        place = data.index(signature) + at
        data[place : place + 4] = struct.pack("<I", 100)
    file.write_bytes(data)
    tracemalloc.start()
    refuse("sensorlogger", file, "bomb.zip")
    assert tracemalloc.get_traced_memory()[1] < 4 << 20
    tracemalloc.stop()


def test_a_line_without_end_is_refused(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("t,gx,gy,gz,ax,ay,az\n" + "1," * (1 << 20))
    refuse("csv", file, "line 2", "longer than 1048576 characters", "--large", options=LOG)


def test_the_flag_raises_the_limits(monkeypatch):
    assert limit_chunk(1000) == 64 << 20
    assert limit_chunk(100 << 20) == 64 * (100 << 20)  # what a file really holds justifies more
    monkeypatch.setenv(LARGE, "1")
    assert limit_chunk(1000) == 64 * (64 << 20)


def test_a_text_file_above_the_limit_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(importer_files, "LARGEST_MEMBER", 100)
    (tmp_path / "log.csv").write_text("t,gx\n" + "1,2\n" * 100)
    refuse("csv", tmp_path / "log.csv", "405 bytes, more than 100", "--large", options=LOG)


FIELDS = {"imu_gyr": (50, 3), "imu_acc": (50, 3), "imu_mag": (50, 3), "opt_quat": (50, 4), "opt_pos": (50, 3)}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"sampling_rate": 0.0}, "sampling_rate is 0 Hz"),
        ({"sampling_rate": np.nan}, "sampling_rate is nan Hz"),
        ({"imu_gyr": 1j * np.ones((50, 3))}, "imu_gyr: holds complex numbers"),
        ({"imu_gyr": np.array([["a"]], dtype=object)}, "imu_gyr: holds no numbers"),
        ({"imu_acc": np.ones((3, 50))}, "imu_acc has the shape (3, 50)"),
    ],
)
def test_a_mat_file_without_real_numbers_gives_one_line_error(tmp_path, changes, says):
    arrays = {name: np.ones(shape) for name, shape in FIELDS.items()}
    fields = {**arrays, "movement": np.ones(50), "sampling_rate": 100.0, **changes}
    scipy.io.savemat(tmp_path / "x.mat", fields)
    refuse("broad", tmp_path / "x.mat", "x.mat", says)


def test_an_hdf5_array_that_claims_terabytes_is_not_read(tmp_path):
    with h5py.File(tmp_path / "x.hdf5", "w") as out:
        out.create_dataset("imu_gyr", (10**12, 3), dtype="f8", chunks=(1024, 3))
    refuse("broad", tmp_path / "x.hdf5", "/imu_gyr claims 24000000000000 bytes", "--large")


@pytest.mark.parametrize("text", ['{"trials":' * 50_000, "[" * 100_000, "\xff\xfe", '{"trials": 3}'])
def test_an_invalid_list_of_trials_is_refused(tmp_path, text):
    arrays = {name: np.ones(shape) for name, shape in FIELDS.items()}
    scipy.io.savemat(tmp_path / "x.mat", {**arrays, "movement": np.ones(50), "sampling_rate": 100.0})
    (tmp_path / "trials.json").write_bytes(text.encode("latin-1"))
    refuse("broad", tmp_path / "x.mat", "trials.json", "BROAD's list of trials")


@pytest.mark.parametrize("compressed", [False, True])
def test_a_struct_that_claims_millions_of_elements_is_not_made(tmp_path, compressed):
    """The loader would make room for them one by one, for minutes."""
    file = tmp_path / "x.mat"
    scipy.io.savemat(file, {"outer": {"inner": {"a": np.ones(3), "b": "text", "c": [1.0, {"d": 2.0}]}}})
    inner = load_mat(file)["outer"]["inner"]
    assert (inner["a"].tolist(), inner["b"]) == ([[1, 1, 1]], "text")
    data = bytearray(file.read_bytes())
    dims = struct.pack("<IIii", 5, 8, 1, 1)
    places = [k for k in range(len(data)) if data[k : k + 16] == dims]
    assert len(places) > 4
    for place in places[:2]:  # the outer struct, the inner one
        changed = bytearray(data)
        changed[place + 8 : place + 16] = struct.pack("<ii", 700_000_000, 1)
        if compressed:
            packed = zlib.compress(bytes(changed[128:]))
            changed = changed[:128] + struct.pack("<II", 15, len(packed)) + packed
        file.write_bytes(changed)
        with pytest.raises(ValueError, match="claims 700000000 elements of"):
            load_mat(file)


@pytest.mark.parametrize("compressed", [False, True])
def test_matlab_files_are_read_as_scipy_reads_them(tmp_path, compressed):
    rng = np.random.default_rng(4)
    numbers = {
        "doubles": rng.normal(size=(4, 3)),
        "cube": rng.normal(size=(2, 3, 4)),
        "single": rng.normal(size=(3, 2)).astype(np.float32),
        "bytes": np.arange(6, dtype=np.uint8).reshape(2, 3),
        "whole": np.array([[-5, 70_000]], dtype=np.int32),
        "flags": np.array([[True, False]]),
        "waves": rng.normal(size=(2, 2)) + 1j,
        "nothing": np.empty((0, 3)),
        "small_whole_doubles": np.array([[1.0, 2.0]]),
    }
    scipy.io.savemat(
        tmp_path / "x.mat",
        {**numbers, "text": "Grüße", "cells": np.array([1.0, "b"], dtype=object)},
        do_compression=compressed,
    )
    found, known = load_mat(tmp_path / "x.mat"), scipy.io.loadmat(tmp_path / "x.mat")
    for name in numbers:
        np.testing.assert_array_equal(found[name], known[name])
    assert found["text"] == "Grüße"
    assert found["cells"][0].item() == 1.0
    assert found["cells"][1] == "b"
