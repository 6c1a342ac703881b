"""Round trips through files, bit for bit; same input, same bytes; files that are cut, broken or of another kind."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from anything import estimates, recordings, references, spin_references
from hypothesis import given, settings

from stillpoint.datasets import BadFile, BadRecording, Gps, Imu, Info, Mag, Recording, Reference, Truth, read, write
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.mcap import store
from stillpoint.datasets.mcap.writer import write_mcap


def assert_same(a, b, where=""):
    """Equal to the last bit: dtypes, shapes, NaN payloads in arrays, signs of zero, types of containers."""
    assert type(a) is type(b), where
    if is_dataclass(a):
        for field in fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name), f"{where}.{field.name}")
    elif isinstance(a, np.ndarray):
        assert (a.dtype, a.shape) == (b.dtype, b.shape), where
        assert a.tobytes() == b.tobytes(), where
    elif isinstance(a, float) and not (np.isnan(a) and np.isnan(b)):
        assert np.float64(a).tobytes() == np.float64(b).tobytes(), where
    elif isinstance(a, dict):
        assert list(a) == list(b), where
        for key in a:
            assert_same(a[key], b[key], f"{where}[{key}]")
    elif isinstance(a, list | tuple):
        assert len(a) == len(b), where
        for k, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_same(x, y, f"{where}[{k}]")
    elif not isinstance(a, float):
        assert a == b, where


@pytest.mark.slow
@pytest.mark.parametrize("things", [
    pytest.param(recordings(), id="recordings"),
    pytest.param(references(), id="references"),
    pytest.param(spin_references(), id="references of spins"),
    pytest.param(estimates(), id="estimates"),
])  # fmt: skip
def test_every_thing_comes_back_bit_for_bit(tmp_path_factory, things):
    path = tmp_path_factory.mktemp("store") / "thing.mcap"

    @settings(max_examples=50)
    @given(things)
    def round_trip(thing):
        write(path, thing)
        assert_same(thing, read(path))

    round_trip()


def phone(n=600, seed=1, **changes):
    """A recording with all that a phone gives, several chunks long."""
    rng = np.random.default_rng(seed)
    t = np.arange(n, dtype=np.int64) * 10_000_000 + 1_700_000_000_000_000_000
    q = rng.normal(size=(n, 4))
    parts = {
        "imu": Imu(t, rng.normal(size=(n, 3)), rng.normal(size=(n, 3)) + np.array([0, 0, 9.81])),
        "mag": Mag(t[::2] + 3, rng.normal(size=(len(t[::2]), 3)) + np.array([20, 0, -40])),
        "truth": Truth(t, q / np.linalg.norm(q, axis=1, keepdims=True), rng.random(n) > 0.5),
        "info": Info(source="test", epoch="unix"),
    }
    return Recording("phone", **{**parts, **changes})


def reference_of(n=50):
    t = np.arange(n, dtype=np.int64) * 10_000_000
    return Reference(t, np.tile([1.0, 0, 0, 0], (n, 1)), np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)), method="m")


def test_a_real_recording_comes_back_bit_for_bit(data_dir, tmp_path):
    """An optical trial of BROAD: unquantised truth with gaps, a field in microtesla from a float32 sensor."""
    (recording,) = IMPORTERS["broad"](data_dir / "broad" / "10_undisturbed_slow_translation_A.mat")
    write(tmp_path / "x.mcap", recording)
    assert_same(recording, read(tmp_path / "x.mcap"))


def test_the_same_input_gives_the_same_bytes(tmp_path):
    for name in ("a.mcap", "b.mcap"):
        write(tmp_path / name, phone(), attachments={"calibration.json": b"{}"})
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    assert store.sha256(tmp_path / "a.mcap") == store.sha256(tmp_path / "b.mcap")


def test_a_file_says_what_it_is_and_how_it_was_made(tmp_path):
    path = tmp_path / "r.mcap"
    write(path, replace(reference_of(), made_from={"a.mcap": "ab12"}, params={"k": 1}), attachments={"log": b"\0\1"})
    said = store.read_provenance(path)
    assert (said.kind, said.attachments, said.lost) == ("reference", {"log": b"\0\1"}, "")
    assert (said.facts["made_from"], said.facts["params"]) == ({"a.mcap": "ab12"}, {"k": 1})
    assert said.topics["/reference/attitude"] == ("sensor_msgs/msg/Imu", 50)
    assert "East-North-Up" in said.convention


def test_a_file_of_another_kind_is_refused_by_name(tmp_path):
    path = tmp_path / "r.mcap"
    write(path, reference_of())
    with pytest.raises(BadFile, match=r"r\.mcap: holds one reference; this needs one recording"):
        store.read_recording(path)
    with pytest.raises(BadFile, match="this needs one estimate"):
        store.read_estimate(path)
    assert_same(store.read_reference(path), reference_of())


def test_implausible_units_are_opened_only_on_request(tmp_path):
    path = tmp_path / "g.mcap"
    in_g = replace(phone().imu, accel_b_mps2=np.tile([0.0, 0.0, 1.0], (600, 1)))
    write(path, phone(imu=in_g, info=Info(units_unchecked=True)))
    raw = path.read_bytes()
    assert store.read_recording(path).info.units_unchecked
    with pytest.raises(BadRecording, match="in g"):
        phone(imu=in_g)
    assert store.read_recording(path, units_unchecked=True).imu.accel_b_mps2[0, 2] == 1.0
    assert raw == path.read_bytes()


def test_parameters_that_json_has_no_word_for_are_refused_before_a_file_is_there(tmp_path):
    with pytest.raises(BadRecording, match=r"facts\.params\.how: is a function"):
        write(tmp_path / "x.mcap", replace(reference_of(), params={"how": lambda: 0}))
    assert list(tmp_path.iterdir()) == []


def test_numpy_values_in_parameters_become_plain_numbers(tmp_path):
    params = {"gain": np.float64(0.1), "n": np.int32(3), "axes": np.eye(2), "nan": float("nan"), "pair": (1, 2)}
    write(tmp_path / "x.mcap", replace(reference_of(), params=params))
    back = store.read_reference(tmp_path / "x.mcap").params
    assert back["gain"] == 0.1
    assert np.isnan(back["nan"])
    assert (back["n"], back["axes"], back["pair"]) == (3, [[1.0, 0.0], [0.0, 1.0]], [1, 2])


# --- files that are cut or broken


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    path = tmp_path_factory.mktemp("small") / "small.mcap"
    write(path, phone(n=12), attachments={"notes.txt": b"as it was"})
    return path


@pytest.mark.slow
def test_any_flipped_bit_is_found(small, tmp_path):
    """CRCs of chunks, data section, attachments and summary, the magics and the footer leave no byte out."""
    whole = small.read_bytes()
    rng = np.random.default_rng(3)
    ends = [*range(60), *range(len(whole) - 60, len(whole))]
    for at in [*ends, *rng.choice(len(whole), 300, replace=False).tolist()]:
        broken = bytearray(whole)
        broken[at] ^= 1 << int(rng.integers(8))
        path = tmp_path / "broken.mcap"
        path.write_bytes(broken)
        with pytest.raises(BadFile) as caught:
            read(path)
        assert "\n" not in str(caught.value)
        assert "broken.mcap: " in str(caught.value)


def test_a_cut_recording_gives_its_whole_chunks_and_says_what_is_lost(tmp_path):
    n = 18_000  # six chunks of each sensor
    recording = phone(n)
    path, cut = tmp_path / "whole.mcap", tmp_path / "cut.mcap"
    write(path, recording)
    whole = path.read_bytes()
    read_samples = []
    for share in (0.35, 0.5, 0.7, 0.9, 0.999, 1 - 1 / len(whole)):
        cut.write_bytes(whole[: int(len(whole) * share)])
        back = store.read_recording(cut)
        k, m, j = len(back.imu.t_ns), len(back.mag.t_ns), len(back.truth.t_ns)
        read_samples.append(k)
        assert back.imu.gyro_b_radps.tobytes() == recording.imu.gyro_b_radps[:k].tobytes()
        assert back.mag.mag_b_ut.tobytes() == recording.mag.mag_b_ut[:m].tobytes()
        assert back.truth.moving.tobytes() == recording.truth.moving[:j].tobytes()
        (note,) = back.info.notes
        assert "cut" in note
        if k < n:
            assert f"/imu/data_raw {k} of {n}" in note
    assert read_samples == sorted(read_samples)
    assert read_samples[0] < read_samples[2] < read_samples[-1] == n


@pytest.mark.slow
def test_a_cut_anywhere_ends_in_a_recording_or_one_line(small, tmp_path):
    whole = small.read_bytes()
    path = tmp_path / "cut.mcap"
    for end in range(0, len(whole), 37):
        path.write_bytes(whole[:end])
        try:
            assert read(path).info.notes
        except BadFile as error:
            assert "\n" not in str(error)  # noqa: PT017


def test_a_cut_reference_is_refused(tmp_path):
    path = tmp_path / "r.mcap"
    write(path, reference_of())
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(BadFile, match="a reference that was cut cannot be used"):
        read(path)


@pytest.mark.parametrize(
    ("content", "says"), [(b"", "is empty"), (b"\x89PNG" * 9, "is not an MCAP file"), (None, "cannot be opened")]
)
def test_what_is_no_mcap_file_is_named(tmp_path, content, says):
    path = tmp_path / "x.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BadFile, match=says):
        read(path)


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "x.mcap"
    write(path, reference_of())
    before = path.read_bytes()

    def full(_handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(BadFile, match=r"x\.mcap: cannot be written \(No space left on device\)"):
        write(path, phone())
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["x.mcap"]
    with pytest.raises(BadFile, match="cannot be written"):
        write(tmp_path / "no" / "x.mcap", phone())


def test_a_device_or_a_folder_is_never_replaced(tmp_path):
    (tmp_path / "folder.mcap").mkdir()
    for path in ("/dev/null", tmp_path / "folder.mcap"):
        with pytest.raises(BadFile, match="not an ordinary file"):
            write(path, reference_of())
    (tmp_path / "link.mcap").symlink_to(tmp_path / "real.mcap")
    write(tmp_path / "link.mcap", reference_of())
    assert (tmp_path / "link.mcap").is_symlink()
    assert_same(read(tmp_path / "real.mcap"), reference_of())


@pytest.mark.parametrize(
    "facts",
    [
        "nonsense",
        "[]",
        "{}",
        '{"samples": 3, "absent": []}',
        '{"samples": {}, "absent": []}',
        '{"samples": {}, "absent": [], "name": "x", "base_pose": 3, "info": {"colour": "red"}}',
        "[" * 100_000,
    ],
)
def test_facts_that_make_no_sense_are_one_line(tmp_path, facts):
    record = {"kind": "recording", "format": "1", "version": "0", "facts": facts}
    write_mcap(tmp_path / "x.mcap", [], {"stillpoint": record}, {})
    with pytest.raises(BadFile, match="its facts"):
        read(tmp_path / "x.mcap")


def gps(n=9):
    t = np.arange(n, dtype=np.int64) * 10**9
    place = np.full(n, 50.0)
    return Gps(t, place, place, place, np.zeros(n), np.ones(n), np.ones(n, bool))


@pytest.mark.parametrize(
    ("lacks", "known", "says"),
    [
        ("/gps/course", False, "/gps/course should have 9 messages and has 8"),
        ("/gps/course", True, "/gps/course has other times than the rest of its stream"),
        ("/imu/mag_remainder", False, "/imu/mag_remainder should have"),
    ],
)
def test_a_whole_file_that_lacks_messages_is_refused(tmp_path, lacks, known, says):
    """As when a tool filtered it; the facts say how many there were, and topics of one stream share their times."""
    streams, record = store.make_contents(phone(gps=gps()))
    for k, stream in enumerate(streams):
        if stream.topic == lacks:
            columns = {leaf: values[:-1] for leaf, values in stream.columns.items()}
            streams[k] = replace(stream, t_ns=stream.t_ns[:-1], columns=columns)
    if known:
        record["facts"] = record["facts"].replace('"/gps/course": 9', '"/gps/course": 8')
    write_mcap(tmp_path / "x.mcap", streams, {"stillpoint": record}, {})
    with pytest.raises(BadFile, match=says):
        read(tmp_path / "x.mcap")


def test_a_remainder_of_another_time_than_its_field_is_refused(tmp_path):
    streams, record = store.make_contents(phone())
    remainder = next(k for k, stream in enumerate(streams) if stream.topic == "/imu/mag_remainder")
    streams[remainder] = replace(streams[remainder], t_ns=streams[remainder].t_ns + 1)
    write_mcap(tmp_path / "x.mcap", streams, {"stillpoint": record}, {})
    with pytest.raises(BadFile, match="/imu/mag_remainder has times that the magnetometer does not have"):
        read(tmp_path / "x.mcap")


def test_a_file_of_a_later_format_asks_for_a_newer_stillpoint(tmp_path):
    write_mcap(tmp_path / "x.mcap", [], {"stillpoint": {"kind": "recording", "format": "2", "version": "9.0"}}, {})
    with pytest.raises(BadFile, match=r"written by stillpoint 9\.0; .*install the newer one"):
        read(tmp_path / "x.mcap")


def test_a_written_file_has_the_mode_of_any_new_file(tmp_path):
    write(tmp_path / "x.mcap", reference_of())
    (tmp_path / "plain").touch()
    assert (tmp_path / "x.mcap").stat().st_mode == (tmp_path / "plain").stat().st_mode
