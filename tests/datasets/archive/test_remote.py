"""Archives and files behind URLs: memory, and a server of the S3 protocol on the loopback whose connections drop."""

import socket
import threading

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shelf import write_family, write_recording

from stillpoint.datasets import Imu, Info, Mag, Recording, Truth, read, write
from stillpoint.datasets.archive import create_archive, open_archive
from stillpoint.datasets.archive.repair import Copies, repair_archive
from stillpoint.datasets.archive.verify import verify_archive
from stillpoint.datasets.errors import BadFile, BadParameter
from stillpoint.datasets.files.remote import RangedFile, get_url, is_url, list_files
from stillpoint.datasets.frames import quaternion
from stillpoint.datasets.mcap.indexed import Window, read_part
from stillpoint.datasets.mcap.reader import read_log

fsspec = pytest.importorskip("fsspec")


class Relay:
    """Passes connections on to a server, and cuts those that it is told to after some bytes of the answer."""

    def __init__(self, port):
        self.target = port
        self.cuts = []  # bytes after which the next connections are cut
        self.cut_count = 0
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            try:
                client, _ = self.listener.accept()
            except OSError:
                return
            server = socket.create_connection(("127.0.0.1", self.target))
            threading.Thread(target=self._pump, args=(client, server, False), daemon=True).start()
            threading.Thread(target=self._pump, args=(server, client, True), daemon=True).start()

    def _pump(self, source, sink, is_answer):
        left = None
        try:
            while data := source.recv(65536):
                if is_answer and left is None and self.cuts and len(data) > 1000:
                    left = self.cuts.pop(0)
                if left is not None and len(data) >= left:
                    sink.sendall(data[:left])
                    self.cut_count += 1
                    break
                sink.sendall(data)
                left = None if left is None else left - len(data)
        except OSError:
            pass
        for end in (source, sink):
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                end.close()


@pytest.fixture(scope="module")
def relay():
    """A server of the S3 protocol behind a relay."""
    pytest.importorskip("s3fs")
    moto_server = pytest.importorskip("moto.server")
    server = moto_server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    relay = Relay(server.get_host_and_port()[1])
    yield relay
    relay.listener.close()
    server.stop()


@pytest.fixture
def s3(relay, monkeypatch):
    """A bucket on that server; the client finds it through the environment."""
    import s3fs

    for name, value in {
        "AWS_ACCESS_KEY_ID": "testing",
        "AWS_SECRET_ACCESS_KEY": "testing",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{relay.port}",
    }.items():
        monkeypatch.setenv(name, value)
    s3fs.S3FileSystem.clear_instance_cache()
    filesystem = fsspec.filesystem("s3")
    if not filesystem.exists("lab"):
        filesystem.mkdir("lab")
    return filesystem


@pytest.fixture
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture(params=["memory", pytest.param("s3", marks=pytest.mark.slow)])
def place(request, cache):
    """The URL of a new archive."""
    if request.param == "memory":
        return f"memory://archives/{request.node.name}"
    request.getfixturevalue("s3")
    return f"s3://lab/{abs(hash(request.node.name))}"


def test_paths_keep_their_urls():
    assert get_url("s3:/bucket/a.mcap") == get_url("s3://bucket/a.mcap") == "s3://bucket/a.mcap"
    assert is_url("memory://a/b")
    assert not is_url("C:/data/a.mcap")
    assert not is_url("/data/a.mcap")
    assert not is_url("data/s3:/a")


def test_a_remote_archive_is_as_a_local_one(place, tmp_path):
    files = write_family(tmp_path, "walk", 1)
    with create_archive(place) as archive:
        assert [one.status for one in archive.add(files, ["fast"])] == ["added"] * 3
        assert [one.status for one in archive.add(files)] == ["present"] * 3
        before = archive.catalogue.dump()
        entry = archive.resolve("walk")
        assert read(archive.find_path(entry)).imu.t_ns.tobytes() == read(files[0]).imu.t_ns.tobytes()
        assert verify_archive(archive).faults == ()
        for file in archive.home.glob("catalogue.sqlite*"):
            file.unlink()
    with open_archive(place) as archive:  # on another machine: the catalogue is made from the objects
        assert archive.catalogue.dump() == before
        assert [found.name for found in archive.find("tag:fast and kind:recording")] == ["walk"]
        archive.label([entry.sha256], ["checked"])
        assert archive.read_record(entry.sha256).tags == ("checked", "fast")


def test_damage_in_a_remote_archive_is_found_and_mended(place, tmp_path):
    files = write_family(tmp_path, "walk", 1)
    with create_archive(place) as archive:
        list(archive.add(files))
        record = archive.read_record(archive.resolve("walk").sha256)
        filesystem, root = fsspec.core.url_to_fs(place)
        data = bytearray(filesystem.cat_file(f"{root}/{record.object_key}"))
        data[len(data) // 2] ^= 1
        filesystem.pipe_file(f"{root}/{record.object_key}", bytes(data))
        faults = verify_archive(archive).faults
        assert [fault.level for fault in faults] == ["object"]
        _, left = repair_archive(archive, faults, Copies(tmp_path))
        assert left == []
        assert verify_archive(archive).faults == ()


def write_phone(path, minutes=10):
    """Rates as phones have them: IMU 200 Hz, magnetometer 50 Hz, a truth of 60 Hz; noise as no compressor packs it."""
    rng = np.random.default_rng(3)
    clocks = [np.arange(int(60 * minutes * hz), dtype=np.int64) * (10**9 // hz) for hz in (200, 50, 60)]
    gyro, accel, field = (rng.normal(size=(len(clocks[k]), 3)) for k in (0, 0, 1))
    q_nb = quaternion(Rotation.from_rotvec(rng.normal(size=(len(clocks[2]), 3))))
    truth = Truth(clocks[2], q_nb, np.ones(len(q_nb), np.bool_))
    imu, mag = Imu(clocks[0], gyro, accel + np.array([0, 0, 9.81])), Mag(clocks[1], field + np.array([0, 20, -40]))
    write(path, Recording(path.stem, imu, mag, truth=truth, info=Info()))
    return path


@pytest.mark.slow
def test_one_topic_of_a_file_on_s3_costs_less_than_a_fifth_of_it(s3, relay, tmp_path):
    """A magnetometer is a tenth of a phone's file. A range whose connection drops in the middle is asked for again."""
    path = write_phone(tmp_path / "phone.mcap")
    s3.put_file(str(path), "lab/phone.mcap")
    undisturbed = RangedFile("s3://lab/phone.mcap")
    read_part("s3://lab/phone.mcap", ["/imu/mag"], source=undisturbed)
    assert undisturbed.size == path.stat().st_size
    assert undisturbed.bytes_fetched < 0.2 * undisturbed.size
    magnetometer = RangedFile("s3://lab/phone.mcap")
    relay.cuts, relay.cut_count = [40_000], 0
    part = read_part("s3://lab/phone.mcap", ["/imu/mag"], source=magnetometer)
    assert (relay.cut_count, relay.cuts) == (1, [])
    assert magnetometer.bytes_fetched < 0.2 * magnetometer.size
    whole = read_log(path, ["/imu/mag"]).topics["/imu/mag"]
    assert part.topics["/imu/mag"].t_ns.tobytes() == whole.t_ns.tobytes()
    for leaf in whole.parts[0].columns:
        assert part.topics["/imu/mag"].column(leaf).tobytes() == whole.column(leaf).tobytes()
    minute = RangedFile("s3://lab/phone.mcap")
    read_part("s3://lab/phone.mcap", window=Window(120 * 10**9, 130 * 10**9), source=minute)
    assert minute.bytes_fetched < 0.2 * minute.size


@pytest.mark.slow
def test_a_connection_that_drops_in_the_middle_costs_one_more_request(s3, relay, tmp_path):
    path = write_recording(tmp_path / "drop.mcap", 4, n=20_000)
    s3.put_file(str(path), "lab/drop.mcap")
    relay.cuts, relay.cut_count = [40_000, 90_000], 0
    assert read("s3://lab/drop.mcap").imu.gyro_b_radps.tobytes() == read(path).imu.gyro_b_radps.tobytes()
    assert relay.cut_count == 2


@pytest.mark.slow
def test_a_server_that_never_answers_whole_gives_one_line_error(s3, relay, tmp_path):
    path = write_recording(tmp_path / "dead.mcap", 5, n=20_000)
    s3.put_file(str(path), "lab/dead.mcap")
    relay.cuts = [5000] * 200
    with pytest.raises(BadFile, match="check the connection") as caught:
        read("s3://lab/dead.mcap")
    relay.cuts = []
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_commands_take_urls(s3, call, tmp_path, capsys):
    for file in write_family(tmp_path, "walk", 1):
        s3.put_file(str(file), f"lab/walks/{file.name}")
    assert call("info", "s3://lab/walks/walk.mcap") == 0
    assert "recording walk" in capsys.readouterr().out
    assert call("estimate", "s3://lab/walks", "-e", "cf", "-o", tmp_path / "out") == 0
    assert (tmp_path / "out" / "walk.cf.estimate.mcap").is_file()
    assert call("score", "s3://lab/walks/walk.ekf.estimate.mcap", "--align", "none") == 0
    assert call("info", "s3://lab/walks/absent.mcap") == 2
    assert len(list_files("s3://lab/walks/*.reference.mcap", ".mcap")) == 1
    with pytest.raises(BadParameter, match="there is no file"):
        list_files("s3://lab/nothing", ".mcap")
