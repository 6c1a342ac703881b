"""Published datasets come whole or not at all, from a server with the paths of the authors' repositories."""

import hashlib
import http.server
import json
import threading

import numpy as np
import pytest

from stillpoint.datasets.errors import BadParameter, BadSource
from stillpoint.datasets.fetch import SOURCES, download, fetch_trials, find_source
from stillpoint.datasets.mcap.store import read_recording

BROAD, REPOIMU = SOURCES["broad"], SOURCES["repoimu"]
STATIC = "TStick/TStick_Test01_Static.csv"


class _Server(http.server.ThreadingHTTPServer):
    """Files by path on the loopback, with faults that a test puts on: each is used up by one request."""

    def __init__(self):
        self.files, self.faults, self.asked = {}, {}, []
        super().__init__(("127.0.0.1", 0), _Answer)
        self.address = f"http://127.0.0.1:{self.server_port}/mirror"


class _Answer(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        path = self.path.removeprefix("/mirror/")
        self.server.asked.append(path)
        body = self.server.files.get(path)
        if body is None:
            self.send_error(404)
            return
        fault = self.server.faults.get(path, []).pop(0) if self.server.faults.get(path) else ""
        sent = body[:-1] + b"?" if fault == "damage" else body
        self.send_response(200)
        self.send_header("Content-Length", str(len(sent)))
        self.end_headers()
        self.wfile.write(sent[: len(sent) // 2] if fault == "drop" else sent)

    def log_message(self, *_):
        pass


@pytest.fixture
def server(monkeypatch):
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setattr("pooch.core.time.sleep", lambda _: None)
    server = _Server()
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


def stick_csv(n=600):
    """A T-stick that lies still, in the two lines of titles and the columns of RepoIMU."""
    lines = ["Time (s);Vicon Orientation;;;;IMU Acceleration;;;IMU Gyroscope;;;IMU Magnetometer;;;"]
    lines.append(";W;X;Y;Z;X;Y;Z;X;Y;Z;X;Y;Z;")
    rng = np.random.default_rng(1)
    for k in range(1, n + 1):
        accel, gyro = rng.normal([0, 0, 9.81], 0.01), rng.normal(0, 0.003, 3)
        cells = [k / 100, 1, 0, 0, 0, *accel, *gyro, -0.17, 0.36, -0.89]
        lines.append(";".join(f"{cell:.5g}" if k else "" for cell in cells))
    return ("\n".join(lines) + "\n").encode()


def test_the_addresses_name_a_commit_and_the_pinned_files_are_files_of_the_dataset():
    for source in SOURCES.values():
        assert source.address.rstrip("/").rsplit("/", 1)[1].isalnum()
        assert len(source.address.rstrip("/").rsplit("/", 1)[1]) == 40
        of_trials = {path for trial in source.trials for path in source.files(trial)} | set(source.shared)
        pinned = download.read_pinned_sums(source)
        assert set(pinned) <= of_trials, "a pinned path that no trial has is never checked"
        assert all(len(value) == 64 for value in pinned.values())
    counts = {name: len(source.trials) for name, source in SOURCES.items()}
    assert counts == {"broad": 39, "tyrex": 126, "repoimu": 29}


def test_the_sums_are_those_of_the_real_files(data_dir):
    for name, inside in (("broad", "data_mat"), ("tyrex", "datasets")):
        pinned = download.read_pinned_sums(SOURCES[name])
        for path, value in list(pinned.items())[::8]:
            file = data_dir / name / path.removeprefix(f"{inside}/")
            assert hashlib.sha256(file.read_bytes()).hexdigest() == value, path


@pytest.mark.parametrize(
    ("name", "texts", "found"),
    [
        ("broad", ["02", "39"], ["02_undisturbed_slow_rotation_B", "39_disturbed_mixed"]),
        ("broad", ["*tapping*"], ["24_disturbed_tapping_A", "25_disturbed_tapping_B"]),
        ("repoimu", ["TStick_Test06"], ["TStick_Test06_Trial1", "TStick_Test06_Trial2"]),
    ],
)
def test_trials_are_chosen_by_name_beginning_or_glob(name, texts, found):
    assert find_source(name).select(texts) == found


def test_unknown_names_are_answered_with_the_nearest():
    with pytest.raises(BadParameter, match="did you mean 'tyrex'"):
        find_source("tyrx")
    with pytest.raises(BadParameter, match="no trial '40'"):
        BROAD.select(["40"])


def test_whole_files_are_kept_and_others_fetched_again(server, tmp_path):
    server.files[STATIC] = stick_csv()
    first = fetch_trials(REPOIMU, ["TStick_Test01_Static"], tmp_path, server.address)
    assert [(one.downloaded, one.first_seen) for one in first] == [(True, True)]
    again = fetch_trials(REPOIMU, ["TStick_Test01_Static"], tmp_path, server.address)
    assert [(one.downloaded, one.first_seen) for one in again] == [(False, False)]
    assert server.asked == [STATIC]
    (tmp_path / STATIC).write_bytes(b"half of it")
    mended = fetch_trials(REPOIMU, ["TStick_Test01_Static"], tmp_path, server.address)
    assert mended[0].downloaded
    assert (tmp_path / STATIC).read_bytes() == server.files[STATIC]


def test_a_dropped_connection_and_a_damaged_file_are_tried_again(server, tmp_path, monkeypatch):
    body = stick_csv()
    server.files[STATIC] = body
    monkeypatch.setattr(download, "read_pinned_sums", lambda _: {STATIC: hashlib.sha256(body).hexdigest()})
    server.faults[STATIC] = ["drop", "damage"]
    fetch_trials(REPOIMU, ["TStick_Test01_Static"], tmp_path, server.address)
    assert (tmp_path / STATIC).read_bytes() == body
    assert server.asked == [STATIC] * 3


def test_what_never_matches_is_refused_and_leaves_nothing(server, tmp_path):
    path = BROAD.files(BROAD.select(["02"])[0])[0]
    server.files |= {"data_mat/trials.json": b"{}", path: b"another file"}
    with pytest.raises(BadSource, match=r"trials\.json: the download had another SHA-256 than the known one, 3 times"):
        fetch_trials(BROAD, BROAD.select(["02"]), tmp_path, server.address)
    assert not [file for file in tmp_path.rglob("*") if file.is_file()]


def test_a_run_that_was_stopped_goes_on_with_the_first_missing_file(server, tmp_path):
    trials = REPOIMU.select(["TStick_Test01_Static", "TStick_Test02_Trial1"])
    server.files[STATIC] = stick_csv()
    with pytest.raises(BadSource, match=r"Trial1\.csv: cannot be fetched \(HTTP 404\)"):
        fetch_trials(REPOIMU, trials, tmp_path, server.address)
    server.files["TStick/TStick_Test02_Trial1.csv"] = stick_csv(700)
    server.asked.clear()
    assert [one.downloaded for one in fetch_trials(REPOIMU, trials, tmp_path, server.address)] == [False, True]
    assert server.asked == ["TStick/TStick_Test02_Trial1.csv"]


def test_an_address_that_is_no_server_is_refused(tmp_path):
    with pytest.raises(BadParameter, match="http://"):
        fetch_trials(REPOIMU, REPOIMU.trials[:1], tmp_path, "ftp://host/")


def test_the_verb_imports_and_the_file_keeps_licence_and_citation(call, server, tmp_path, capsys):
    server.files[STATIC] = stick_csv()
    words = ("fetch", "repoimu", "--trials", "TStick_Test01", "-o", tmp_path, "--mirror", server.address)
    assert call(*words, "--import", tmp_path / "out") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "licence: none stated by the authors" in said
    assert "Szczesna" in said
    recording = read_recording(tmp_path / "out" / "TStick_Test01_Static.mcap")
    assert recording.info.licence == REPOIMU.licence
    assert recording.info.citation == REPOIMU.citation
    assert np.allclose(recording.mag.mag_b_ut[0], np.array([-0.17, 0.36, -0.89]) * 49.6, atol=0.5)
    assert recording.truth is not None


def test_real_trials_come_through_the_paths_of_the_repository_and_import(call, server, tmp_path, data_dir, capsys):
    inside = {"broad": ("02", "data_mat"), "tyrex": ("Guillaume_iPhone4S_NoDist_AR", "datasets")}
    for name, (text, folder) in inside.items():
        source = SOURCES[name]
        for path in (*source.shared, *(path for trial in source.select([text]) for path in source.files(trial))):
            server.files[path] = (data_dir / name / path.removeprefix(f"{folder}/")).read_bytes()
        words = ("fetch", name, "--trials", text, "-o", tmp_path, "--mirror", server.address)
        assert call(*words, "--import", tmp_path / "out") == 0
        assert "have no SHA-256" not in capsys.readouterr().out
        recording = read_recording(tmp_path / "out" / f"{source.select([text])[0]}.mcap")
        assert (recording.info.licence, recording.info.citation) == (source.licence, source.citation)
        assert recording.truth is not None


def test_the_list_needs_no_server(call, capsys):
    assert call("fetch", "broad", "--list", "--trials", "24,25") == 0
    assert json.dumps(capsys.readouterr().out.split()) == '["24_disturbed_tapping_A", "25_disturbed_tapping_B"]'
