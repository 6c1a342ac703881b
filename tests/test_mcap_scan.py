"""MCAP files that are cut or damaged where no checksum sees it: whole chunks, numbers, or one line."""

import struct

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as OfficialWriter
from ros_messages import FIELD, GYRO, STORE, VECTOR, XYZ, bag, one_topic, vector_message

from stillpoint.datasets import BadFile
from stillpoint.datasets.mcap_reader import read_log


def test_a_writer_that_was_killed_leaves_its_whole_chunks(tmp_path):
    path = tmp_path / "killed.mcap"
    with path.open("wb") as file:
        writer = OfficialWriter(file, chunk_size=20_000)
        writer.start(profile="ros2")
        writer.finish = lambda: None
        bag(path, writer, 900)
    log = read_log(path)
    rows = len(log.topics["/imu"].t_ns)
    assert 700 < rows < 900
    np.testing.assert_array_equal(log.topics["/imu"].vector("angular_velocity", XYZ), GYRO[:rows])
    assert "cut short" in log.lost


def test_the_open_chunk_of_foxglove_sdk_is_left_out(tmp_path):
    """It writes 2^64 - 1 as the length of a chunk that it has not closed."""
    whole = one_topic(tmp_path / "x.mcap", VECTOR, [bytes(STORE.serialize_cdr(vector_message(0), VECTOR))] * 9)
    raw = whole.read_bytes()
    data_end = raw.rindex(struct.pack("<BQ", 15, 4))
    whole.write_bytes(raw[:data_end] + struct.pack("<BQ", 6, 2**64 - 1) + b"\0" * 100)
    log = read_log(whole)
    assert len(log.topics["/x"].t_ns) == 9
    assert "claims 18446744073709551615 bytes" in log.lost


def test_without_checksums_any_flipped_bit_gives_numbers_or_one_line(tmp_path):
    """Foreign files may lack every CRC: then a flip can pass, but never as another exception or a huge allocation."""
    bodies = [bytes(STORE.serialize_cdr(vector_message(k), VECTOR)) for k in range(20)]
    rng = np.random.default_rng(8)
    for options in ({"compression": CompressionType.NONE}, {}, {"use_chunking": False}):
        raw = one_topic(tmp_path / "x.mcap", VECTOR, bodies, enable_crcs=False, **options).read_bytes()
        for at in rng.integers(0, len(raw), 250):
            broken = bytearray(raw)
            broken[at] ^= 1 << int(rng.integers(8))
            (tmp_path / "y.mcap").write_bytes(broken)
            try:
                read_log(tmp_path / "y.mcap")
            except BadFile as error:
                assert "\n" not in str(error)  # noqa: PT017


def test_a_flipped_bit_is_found_by_the_checksum_of_its_chunk_alone(tmp_path):
    """Recorders leave the checksum of the data section out; in a chunk that is not compressed nothing else tells."""
    bodies = [bytes(STORE.serialize_cdr(vector_message(k), VECTOR)) for k in range(20)]
    raw = bytearray(one_topic(tmp_path / "x.mcap", VECTOR, bodies, compression=CompressionType.NONE).read_bytes())
    raw[raw.index(np.float64(FIELD[7, 1]).tobytes())] ^= 1
    (tmp_path / "y.mcap").write_bytes(raw)
    with pytest.raises(BadFile, match="checksum of a chunk differs"):
        read_log(tmp_path / "y.mcap")


def test_an_index_that_points_elsewhere_or_leaves_out_messages_does_not_mislead(tmp_path):
    bodies = [bytes(STORE.serialize_cdr(vector_message(k), VECTOR)) for k in range(20)]
    raw = one_topic(tmp_path / "x.mcap", VECTOR, bodies, enable_crcs=False).read_bytes()
    index = raw.index(struct.pack("<BQH", 7, 6 + 20 * 16, 1))
    for entry, offset in ((3, 5), (3, 2**63), (0, 0), (19, 2**40)):
        broken = bytearray(raw)
        struct.pack_into("<Q", broken, index + 15 + entry * 16 + 8, offset)
        (tmp_path / "y.mcap").write_bytes(broken)
        np.testing.assert_array_equal(read_log(tmp_path / "y.mcap").topics["/x"].vector("vector", XYZ), FIELD[:20])
