"""MCAP files that are cut or damaged where no checksum sees it: whole chunks, numbers, or one line."""

import struct

import lz4.frame
import numpy as np
import pytest
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, DataEnd, Footer, Header
from mcap.writer import CompressionType
from mcap.writer import Writer as OfficialWriter
from ros_messages import FIELD, GYRO, STORE, VECTOR, XYZ, bag, one_topic, vector_message

from stillpoint.datasets import BadFile
from stillpoint.datasets.mcap import scan as mcap_scan
from stillpoint.datasets.mcap.file import MAGIC, MESSAGE_HEAD
from stillpoint.datasets.mcap.reader import read_log


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


@pytest.mark.slow
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


def test_a_flipped_bit_of_an_attachment_is_found_by_its_own_checksum(tmp_path):
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = OfficialWriter(file)
        writer.start()
        writer.add_attachment(0, 0, "notes.txt", "text/plain", b"as it was")
        writer.finish()
    path.write_bytes(path.read_bytes().replace(b"as it was", b"as it xas", 1))
    with pytest.raises(BadFile, match=r"checksum of the attachment notes\.txt differs"):
        read_log(path)


def test_messages_that_are_not_there_are_missed(tmp_path):
    """The summary knows how many there were."""
    bodies = [bytes(STORE.serialize_cdr(vector_message(k), VECTOR)) for k in range(20)]
    raw = one_topic(tmp_path / "x.mcap", VECTOR, bodies, enable_crcs=False).read_bytes()
    (tmp_path / "y.mcap").write_bytes(raw.replace(struct.pack("<Q", 20), struct.pack("<Q", 21), 1))
    with pytest.raises(BadFile, match="should hold 21 messages and holds 20"):
        read_log(tmp_path / "y.mcap")


def test_a_tail_of_zeros_is_a_cut(tmp_path):
    """As file systems leave one after a loss of power: the length was written, the data was not."""
    bodies = [bytes(STORE.serialize_cdr(vector_message(k), VECTOR)) for k in range(20)]
    raw = one_topic(tmp_path / "x.mcap", VECTOR, bodies).read_bytes()
    end = raw.rindex(struct.pack("<BQ", 15, 4))  # of the data
    (tmp_path / "y.mcap").write_bytes(raw[:end] + b"\0" * 900)
    log = read_log(tmp_path / "y.mcap")
    assert len(log.topics["/x"].t_ns) == 20
    assert f"from byte {end} of {end + 900} on" in log.lost


EMPTY_BLOCK = b"\x01\0\0"  # of zstd: raw, the last one, no bytes


@pytest.mark.parametrize(
    ("compression", "data", "size", "says"),
    [
        (
            "zstd",
            b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 2**50) + EMPTY_BLOCK,
            100,
            "claims 100 and 1125899906842624",
        ),
        ("zstd", b"\x28\xb5\x2f\xfd\x00\x58" + EMPTY_BLOCK, 2**40, "claims 1099511627776 bytes"),
        ("zstd", b"\x28\xb5\x2f\xfd\x00\x58" + EMPTY_BLOCK, 100, "has 0 bytes where it claims 100"),
        ("lz4", lz4.frame.compress(bytes(200), store_size=True), 100, "more than the 100 bytes"),
        ("lz4", lz4.frame.compress(bytes(200), store_size=False), 100, "more than the 100 bytes"),
        ("", bytes(99), 100, "has 99 bytes where it claims 100"),
        ("brotli", bytes(100), 100, "compressed by 'brotli'"),
    ],
)
def test_a_chunk_is_as_long_as_it_claims_and_no_claim_asks_for_memory(tmp_path, compression, data, size, says):
    builder = RecordBuilder()
    Header("ros2", "a test").write(builder)
    Chunk(compression, data, 0, 0, 0, size).write(builder)
    DataEnd(0).write(builder)
    Footer(0, 0, 0).write(builder)
    (tmp_path / "x.mcap").write_bytes(MAGIC + builder.end() + MAGIC)
    with pytest.raises(BadFile, match=says):
        read_log(tmp_path / "x.mcap")


def test_messages_outside_chunks_are_handed_out_in_blocks(tmp_path, monkeypatch):
    """So that an hour without chunks is not held twice, as bytes and as columns."""
    monkeypatch.setattr(mcap_scan, "LOOSE_BYTES", 500)
    bodies = [bytes(STORE.serialize_cdr(vector_message(k), VECTOR)) for k in range(50)]
    path = one_topic(tmp_path / "x.mcap", VECTOR, bodies, use_chunking=False)
    blocks = list(mcap_scan.Scan(path).blocks())
    assert len(blocks) > 5
    assert all(len(block.data) < 500 + len(bodies[0]) + MESSAGE_HEAD.itemsize for block in blocks)
    np.testing.assert_array_equal(read_log(path).topics["/x"].vector("vector", XYZ), FIELD[:50])


def test_an_index_that_points_elsewhere_or_leaves_out_messages_does_not_mislead(tmp_path):
    bodies = [bytes(STORE.serialize_cdr(vector_message(k), VECTOR)) for k in range(20)]
    raw = one_topic(tmp_path / "x.mcap", VECTOR, bodies, enable_crcs=False).read_bytes()
    index = raw.index(struct.pack("<BQH", 7, 6 + 20 * 16, 1))
    for entry, offset in ((3, 5), (3, 2**63), (0, 0), (19, 2**40)):
        broken = bytearray(raw)
        struct.pack_into("<Q", broken, index + 15 + entry * 16 + 8, offset)
        (tmp_path / "y.mcap").write_bytes(broken)
        np.testing.assert_array_equal(read_log(tmp_path / "y.mcap").topics["/x"].vector("vector", XYZ), FIELD[:20])


SIZES = {1: 40, 2: 31, 3: 77}  # bytes of a message of each channel


@pytest.mark.parametrize(
    "channels",
    [
        [1] * 9,
        [1, 2] * 5,
        [1, 2, 3] * 4 + [1, 2],
        [1, 1, 2] * 4,
        [1, 2, 2] * 4,
        [1, 2] * 3 + [2, 1] * 3,
        [3],
        [1, 2, 3],
    ],
)
def test_messages_in_turn_lie_where_a_walk_through_them_finds_them(channels):
    data, starts = pack_messages([(channel, SIZES[channel]) for channel in channels])
    block = scan_of(SIZES).read_block(data)
    for channel in set(channels):
        expected = [at for at, one in zip(starts, channels, strict=True) if one == channel]
        assert block.offsets[channel].tolist() == expected
        assert block.heads[channel]["log_time"].tolist() == expected
        assert block.heads[channel]["length"].tolist() == [SIZES[channel] - 9] * len(expected)


@pytest.mark.parametrize("odd", range(6))
def test_one_message_of_another_length_among_those_in_turn_is_found(odd):
    sizes = [SIZES[1]] * 6
    sizes[odd] += 8
    data, starts = pack_messages([(1, size) for size in sizes])
    block = scan_of(SIZES).read_block(data)
    assert block.offsets[1].tolist() == starts
    assert not block.steps, "they do not lie evenly"


@pytest.mark.parametrize("missing", [1, 9, 39])
def test_a_chunk_that_ends_within_a_message_in_turn_is_damaged(missing):
    data, _ = pack_messages([(1, 40)] * 5)
    with pytest.raises(mcap_scan.DamagedError, match="chunk"):
        scan_of(SIZES).read_block(data[:-missing])


def scan_of(channels):
    scan = mcap_scan.Scan("x.mcap")
    scan.channels = dict.fromkeys(channels)
    return scan


def pack_messages(messages):
    """Return records of messages of some channels and sizes, and where each begins, which is its log time too."""
    data, starts = b"", []
    for channel, size in messages:
        starts.append(len(data))
        data += struct.pack("<BQHIQQ", 5, size - 9, channel, 0, len(data), 0) + bytes(size - MESSAGE_HEAD.itemsize)
    return data, starts
