"""``view``: what is shown is what the files hold, read back by rerun itself; without rerun one line says what to do."""

import importlib.util
import sys

import numpy as np
import pytest

from stillpoint.datasets import read, write
from stillpoint.datasets.frames import euler
from stillpoint.datasets.simulate import simulate

NAME = "phone-1-seed0"
MADE = f"{NAME}.reference"
needs_rerun = pytest.mark.skipif(
    importlib.util.find_spec("rerun") is None, reason="rerun-sdk is not installed: pip install 'stillpoint[view]'"
)


@pytest.fixture(scope="module")
def folder(call, tmp_path_factory):
    """A recording and its reference."""
    where = tmp_path_factory.mktemp("view")
    write(where / f"{NAME}.mcap", simulate("phone-1", minutes=1.4))
    assert call("reference", where / f"{NAME}.mcap", "-o", where, "--method", "redistribution") == 0
    return where


def shown(call, folder, *words):
    """What the saved file holds: {(quantity, name): {column: list of rows}}."""
    from rerun.chunk import RrdReader

    file = folder / "scene.rrd"
    assert call("view", folder / f"{NAME}.mcap", "--save", file, *words) == 0
    found = {}
    for chunk in RrdReader(file).stream():
        if chunk.is_static:
            continue
        quantity, _, name = chunk.entity_path.strip("/").replace("\\", "").rpartition("/")
        batch = chunk.to_record_batch()
        columns = found.setdefault((quantity, name), {})
        for column in batch.schema.names:
            cells = batch[column].cast("int64") if column == "time" else batch[column]
            columns.setdefault(column.rpartition(":")[2], []).extend(cells.to_pylist())
    return found


def rows(columns):
    """The values in the order of their times, (N, k), and the times in ns."""
    (values,) = (one for name, one in columns.items() if name in ("scalars", "quaternion"))
    t_ns = np.array(columns["time"], dtype=np.int64)
    order = np.argsort(t_ns, kind="stable")
    return np.array(values)[order], t_ns[order]


@pytest.mark.slow
@needs_rerun
def test_every_sample_of_recording_and_reference_is_shown(call, folder):
    recording, reference = read(folder / f"{NAME}.mcap"), read(folder / f"{MADE}.mcap")
    scene = shown(call, folder)
    rate, t_ns = rows(scene["rate, deg/s", NAME])
    np.testing.assert_array_equal(t_ns, recording.imu.t_ns)
    np.testing.assert_allclose(rate, np.rad2deg(recording.imu.gyro_b_radps))
    angles, t_ns = rows(scene["roll pitch yaw, deg, NWU", MADE])
    np.testing.assert_array_equal(t_ns, reference.t_ns)
    np.testing.assert_allclose(angles, np.rad2deg(euler(reference.q_nb, "nwu")), atol=1e-12)
    sd_deg, _ = rows(scene["sd, deg", MADE])
    np.testing.assert_allclose(
        np.deg2rad(sd_deg[:, 0]) ** 2, np.trace(reference.cov_b_rad2, axis1=1, axis2=2), rtol=1e-9
    )
    turned, _ = rows(scene["sd about east north up, deg", MADE])
    np.testing.assert_allclose((turned**2).sum(axis=1), sd_deg[:, 0] ** 2, rtol=1e-9)
    bias, _ = rows(scene["gyro bias, deg/s", MADE])
    np.testing.assert_allclose(bias, np.rad2deg(reference.gyro_bias_b_radps))
    at_rest, t_ns = rows(scene["at rest", MADE])
    first, last = reference.rests_ns[0]
    assert at_rest[(t_ns >= first) & (t_ns <= last)].all()
    assert 0 < at_rest.mean() < 1
    assert len(scene["returns", MADE]["text"]) == len(reference.returns)


@needs_rerun
def test_bodies_turn_as_the_quaternions_say(call, folder):
    """rerun writes xyzw."""
    scene = shown(call, folder)
    for name, q_nb in (
        (MADE, read(folder / f"{MADE}.mcap").q_nb),
        (f"{NAME} truth", read(folder / f"{NAME}.mcap").truth.q_nb),
    ):
        shown_xyzw, _ = rows(scene["body", name])
        np.testing.assert_allclose(shown_xyzw.reshape(-1, 4)[:, [3, 0, 1, 2]], q_nb, atol=1e-6)


@needs_rerun
def test_alone_leaves_out_what_lies_beside(call, folder):
    assert {name for _, name in shown(call, folder, "--alone")} == {NAME, f"{NAME} truth"}


@needs_rerun
def test_a_place_that_is_not_there_gives_one_line_error(call, folder, capsys):
    assert call("view", folder / f"{NAME}.mcap", "--save", folder / "nowhere" / "x.rrd") == 2
    message = capsys.readouterr().err.strip()
    assert "the folder does not exist" in message
    assert "\n" not in message


def test_without_rerun_one_line_says_what_to_install(call, folder, capsys, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert call("view", folder / f"{NAME}.mcap") == 2
    assert (
        capsys.readouterr().err
        == "stillpoint: view: rerun-sdk is not installed; install it: pip install rerun-sdk==0.41.0\n"
    )


@needs_rerun
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a screen")
def test_without_a_screen_one_line_says_what_to_do(call, folder, monkeypatch, capsys):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert call("view", folder / f"{NAME}.mcap") == 2
    assert capsys.readouterr().err == "stillpoint: view: there is no screen; write a file: --save NAME.rrd\n"


@needs_rerun
def test_a_file_that_cannot_be_read_leaves_no_scene(call, folder, tmp_path, capsys):
    (tmp_path / "broken.mcap").write_bytes(b"no MCAP at all")
    assert call("view", folder / f"{NAME}.mcap", tmp_path / "broken.mcap", "--save", tmp_path / "scene.rrd") == 2
    assert "broken.mcap" in capsys.readouterr().err
    assert not (tmp_path / "scene.rrd").exists()
