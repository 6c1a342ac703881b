"""Of a damaged file everything comes back that lies in a sound chunk, exactly; what is lost is counted and said."""

import numpy as np
import pytest
from shelf import write_recording, write_reference

from stillpoint.datasets import read
from stillpoint.datasets.errors import BadFile
from stillpoint.datasets.mcap.recover import recover_file

N = 9000  # 90 s: three chunks of each sensor


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = write_recording(tmp_path_factory.mktemp("recover") / "run.mcap", 3, n=N)
    return path.read_bytes(), read(path)


def damage(tmp_path, data):
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    return path


def assert_rows_are_exact(back, recording):
    """Every row that came back is one of the recording, bit for bit."""
    for name in ("imu", "mag", "truth"):
        found, known = getattr(back, name), getattr(recording, name)
        if found is None:
            continue
        rows = np.searchsorted(known.t_ns, found.t_ns)
        assert (known.t_ns[rows] == found.t_ns).all()
        for column in vars(known):
            values = getattr(known, column)
            if values is not None:
                assert getattr(found, column).tobytes() == values[rows].tobytes()


def test_an_undamaged_file_comes_back_whole(whole, tmp_path):
    data, recording = whole
    found = recover_file(damage(tmp_path, data), tmp_path / "back.mcap")
    assert found.lost == ()
    assert found.kept == found.expected
    assert_rows_are_exact(read(tmp_path / "back.mcap"), recording)


@pytest.mark.slow
def test_one_flipped_bit_costs_one_chunk_at_most(whole, tmp_path):
    data, recording = whole
    rng = np.random.default_rng(5)
    losses = []
    for at in rng.choice(len(data), 30, replace=False).tolist():
        broken = bytearray(data)
        broken[at] ^= 1 << int(rng.integers(8))
        with pytest.raises(BadFile):
            read(damage(tmp_path, broken))
        found = recover_file(tmp_path / "damaged.mcap", tmp_path / "back.mcap")
        try:
            back = read(tmp_path / "back.mcap")
        except BadFile as error:  # the flip hit the facts, which have no checksum of their own
            assert "facts" in str(error) or "stillpoint" in str(error)  # noqa: PT017
            continue
        assert_rows_are_exact(back, recording)
        lost = [found.expected[topic] - found.kept.get(topic, 0) for topic in found.expected]
        assert sum(1 for count in lost if count) <= 2  # a chunk holds one sensor: at most two topics
        assert max(lost) <= N // 3 + 100
        assert not any(lost) or found.lost
        losses.append(max(lost))
    assert sum(count > 0 for count in losses) > 15  # most of the bytes are those of chunks


def test_what_was_lost_stands_in_the_notes(whole, tmp_path):
    data, _ = whole
    broken = bytearray(data)
    broken[len(data) // 2 : len(data) // 2 + 9] = b"\0" * 9
    found = recover_file(damage(tmp_path, broken), tmp_path / "back.mcap")
    (note,) = read(tmp_path / "back.mcap").info.notes
    assert all(line in note for line in found.lost)
    assert any(" messages" in line for line in found.lost)


@pytest.mark.parametrize("cut", [0.3, 0.6, 0.9])
def test_a_file_without_end_or_with_a_hole_gives_its_sound_chunks(whole, tmp_path, cut):
    data, recording = whole
    place = int(len(data) * cut)
    recover_file(damage(tmp_path, data[:place]), tmp_path / "cut.mcap")
    assert_rows_are_exact(read(tmp_path / "cut.mcap"), recording)
    recover_file(damage(tmp_path, data[:place] + data[place + 5000 :]), tmp_path / "hole.mcap")
    assert_rows_are_exact(read(tmp_path / "hole.mcap"), recording)


def test_a_reference_says_in_its_diagnostics_what_it_lacks(tmp_path):
    recording = write_recording(tmp_path / "run.mcap", n=8000)
    reference = write_reference(tmp_path / "run.reference.mcap", recording, n=8000)
    data = bytearray(reference.read_bytes())
    data[data.find(b"zstd", len(data) // 3) + 400] ^= 1
    recover_file(damage(tmp_path, data), tmp_path / "back.reference.mcap")
    back = read(tmp_path / "back.reference.mcap")
    assert 1000 < len(back.t_ns) < 8000
    assert "lost" in back.diagnostics["recovered"]


def test_nothing_to_rescue_gives_one_line_error(tmp_path):
    for content in (b"", b"no MCAP at all", b"\x89MCAP0\r\n" + b"\x06" + b"\xff" * 300):
        with pytest.raises(BadFile) as caught:
            recover_file(damage(tmp_path, content), tmp_path / "back.mcap")
        assert "\n" not in str(caught.value)
