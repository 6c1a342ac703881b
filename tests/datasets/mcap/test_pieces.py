"""A file read in pieces is the file read whole, and a file written in pieces is the file written whole: bit for bit."""

from dataclasses import fields, replace

import numpy as np
import pytest
from anything import estimates, recordings
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as OfficialWriter

from stillpoint.datasets import BadFile, BadRecording, Gps, Imu, Info, Mag, Recording, Series, Truth, read, write
from stillpoint.datasets.mcap.pieces import PieceReader
from stillpoint.datasets.mcap.store import make_contents, open_trajectory
from stillpoint.datasets.mcap.writer import open_mcap
from stillpoint.datasets.recording import Piece

HOUR_AT_50_HZ = 180_000
STREAMS = [field.name for field in fields(Piece) if field.name != "extra"]


def phone(n=HOUR_AT_50_HZ, seed=1):
    """An hour of sensors on clocks of their own, of which the satellites and the wheel fall silent for a time."""
    rng = np.random.default_rng(seed)
    t = np.arange(n, dtype=np.int64) * 20_000_000 + 1_700_000_000_000_000_000
    slow = t[::50] + 7
    fixed = np.concatenate([slow[:300], slow[-300:]])
    k = len(fixed)
    q = rng.normal(size=(n // 10, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    late = t[n // 2 :: 25]
    return Recording(
        "hour",
        imu=Imu(t, rng.normal(size=(n, 3)) * 0.1, rng.normal(size=(n, 3)) * 0.1 + np.array([0, 0, 9.81])),
        mag=Mag(t[::2] + 3, rng.normal(size=(len(t[::2]), 3)) + np.array([20, 0, -40])),
        gps=Gps(
            fixed, np.full(k, 48.0), np.full(k, 11.0), np.full(k, 500.0), rng.random(k), rng.random(k), np.ones(k, bool)
        ),
        truth=Truth(t[::10], q, np.ones(len(q), bool)),
        extra={"wheel": Series(late, rng.random(len(late)), ("speed_mps",))},
        info=Info(date="2026-01-01", place_lat_lon_alt=(48.0, 11.0, 500.0)),
    )


@pytest.fixture(scope="module")
def hour(tmp_path_factory):
    path = tmp_path_factory.mktemp("hour") / "hour.mcap"
    recording = phone()
    write(path, recording)
    return path, recording


def assert_joined(pieces, recording):
    """The pieces follow each other on every clock, and together are the recording."""
    for name in STREAMS:
        whole, parts = getattr(recording, name), [one for piece in pieces if (one := getattr(piece, name)) is not None]
        if whole is None:
            assert not parts
            continue
        for column in fields(whole):
            values = getattr(whole, column.name)
            if isinstance(values, np.ndarray):
                joined = np.concatenate([getattr(part, column.name) for part in parts])
                assert joined.tobytes() == values.tobytes(), f"{name}.{column.name}"
    for name, series in recording.extra.items():
        joined = np.concatenate([piece.extra[name].values for piece in pieces if name in piece.extra])
        assert joined.tobytes() == series.values.tobytes()


@pytest.mark.slow
def test_pieces_of_bounded_size_join_to_the_recording(hour):
    path, recording = hour
    reader = PieceReader(path, most=10_000)
    assert reader.head.samples == recording.head.samples
    assert reader.head.info == recording.info
    pieces = list(reader.recording())
    assert_joined(pieces, recording)
    # A chunk of the IMU holds some 3000 messages: what waits beyond 10 000 is a chunk or two.
    assert max(len(piece.imu.t_ns) for piece in pieces if piece.imu is not None) < 20_000
    ends = [max(t_ns[-1] for _, t_ns in piece.streams()) for piece in pieces]
    starts = [min(t_ns[0] for _, t_ns in piece.streams()) for piece in pieces]
    assert all(end < start for end, start in zip(ends, starts[1:], strict=False)), "all clocks are cut at one time"


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(recordings())
def test_any_recording_comes_back_from_pieces_of_one_message(tmp_path_factory, recording):
    path = tmp_path_factory.mktemp("any") / "any.mcap"
    write(path, recording)
    assert_joined(list(PieceReader(path, most=1).recording()), read(path))


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(estimates(), st.integers(1, 7))
def test_an_estimate_written_in_pieces_has_the_bytes_of_one_written_at_once(tmp_path_factory, estimate, rows):
    folder = tmp_path_factory.mktemp("pieces")

    def write_in(path, rows):
        with open_trajectory(path) as out:
            for first in range(0, len(estimate.t_ns), rows):
                piece = cut(estimate, slice(first, first + rows))
                out.add(piece)
            out.close(piece)
        return path.read_bytes()

    assert write_in(folder / "a.mcap", rows) == write_in(folder / "b.mcap", len(estimate.t_ns))


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {"chunk_size": 1 << 20, "compression": CompressionType.ZSTD},
        {"chunk_size": 50_000, "compression": CompressionType.LZ4},
        {"chunk_size": 900, "compression": CompressionType.NONE},
        {"chunk_size": 1 << 20, "index_types": IndexType.NONE},
        {"use_chunking": False},
    ],
)
def test_topics_between_each_other_in_odd_chunks_give_the_same_recording(tmp_path, options):
    """The file is as rosbag2 writes it: all topics in the same chunks, by time, schemas and channels in the first."""
    recording = phone(n=32_000)
    write(tmp_path / "own.mcap", recording)
    interleave(tmp_path / "own.mcap", tmp_path / "odd.mcap", **options)
    assert_joined([read(tmp_path / "odd.mcap")], recording)
    assert_joined(list(PieceReader(tmp_path / "odd.mcap", most=200).recording()), recording)


def interleave(source, target, **options):
    """Write the messages of a file once more with another writer, by time, whatever their topic."""
    with source.open("rb") as file, target.open("wb") as out:
        reader, writer = make_reader(file), OfficialWriter(out, **options)
        writer.start(profile="ros2")
        summary = reader.get_summary()
        schemas = {
            old: writer.register_schema(one.name, one.encoding, one.data) for old, one in summary.schemas.items()
        }
        channels = {
            old: writer.register_channel(one.topic, one.message_encoding, schemas[one.schema_id])
            for old, one in summary.channels.items()
        }
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        for _, channel, message in reader.iter_messages(log_time_order=True):
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()


def cut(thing, rows):
    columns = {
        field.name: values[rows]
        for field in fields(thing)
        if isinstance(values := getattr(thing, field.name), np.ndarray)
    }
    return replace(thing, **columns)


@pytest.mark.slow
@pytest.mark.parametrize("span_s", [7.3, 61.0, 900.0])
def test_streams_of_several_groups_written_in_pieces_have_the_bytes_of_one_written_at_once(hour, tmp_path, span_s):
    """Chunks of silent streams end by their span of time, so that the others need not wait for them in memory."""
    path, recording = hour
    streams, record = make_contents(recording)
    first = min(stream.t_ns[0] for stream in streams)
    last = max(stream.t_ns[-1] for stream in streams)
    with open_mcap(tmp_path / "pieces.mcap", read_library(path)) as out:
        out.declare(streams)
        out.describe({"stillpoint": record}, {})
        for start in np.arange(first, last + 1, round(span_s * 1e9)).tolist():
            end = start + round(span_s * 1e9)
            cuts = []
            for stream in streams:
                rows = slice(*np.searchsorted(stream.t_ns, [start, end]))
                columns = {leaf: column[rows] for leaf, column in stream.columns.items()}
                cuts.append(replace(stream, t_ns=stream.t_ns[rows], columns=columns))
            out.add(cuts, end)
    assert (tmp_path / "pieces.mcap").read_bytes() == path.read_bytes()


def read_library(path):
    with open(path, "rb") as file:
        return make_reader(file).get_header().library


@pytest.mark.slow
def test_a_cut_file_gives_the_same_whole_chunks_and_the_same_note(hour, tmp_path):
    path, _ = hour
    data = path.read_bytes()
    target = tmp_path / "cut.mcap"
    target.write_bytes(data[: len(data) * 2 // 3])
    whole, reader = read(target), PieceReader(target, most=10_000)
    assert_joined(list(reader.recording()), whole)
    assert reader.info == whole.info
    assert whole.info.notes, "the loss is told"


def test_damage_is_found_as_in_a_file_read_whole(hour, tmp_path):
    path, _ = hour
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    target = tmp_path / "damaged.mcap"
    target.write_bytes(data)
    with pytest.raises(BadFile, match="is damaged near byte"):
        list(PieceReader(target, most=10_000).recording())


@pytest.mark.slow
def test_units_are_judged_over_the_whole_recording_not_over_a_piece(tmp_path):
    """Ten minutes beside a magnet are no reason to refuse an hour; a field in gauss is."""
    near, gauss = phone(), phone()
    field = near.mag.mag_b_ut.copy()
    field[: len(field) // 6] *= 3
    near = replace(near, mag=Mag(near.mag.t_ns, field))
    write(tmp_path / "near.mcap", near)
    assert len(list(PieceReader(tmp_path / "near.mcap", most=5_000).recording())) > 10
    unchecked = replace(gauss.info, units_unchecked=True)
    gauss = replace(gauss, info=unchecked, mag=Mag(gauss.mag.t_ns, gauss.mag.mag_b_ut / 100))
    with pytest.raises(BadRecording, match="looks like gauss") as whole:
        replace(gauss, info=replace(unchecked, units_unchecked=False))
    write(tmp_path / "gauss.mcap", gauss)
    data = (tmp_path / "gauss.mcap").read_bytes()
    assert b'"units_unchecked": true' in data
    assert len(list(PieceReader(tmp_path / "gauss.mcap").recording())) > 0, "the doctor opens it"
    assert "multiply by 100" in str(whole.value)
