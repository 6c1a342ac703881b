"""Where the pieces of a recording end changes no bit of an estimate, and no count."""

from dataclasses import fields, replace

import numpy as np
import pytest
from motions import untidy
from spins import QUIET

from stillpoint.datasets import BadParameter, BadRecording, Estimate, Gps, Recording
from stillpoint.datasets.cut import slice_stream
from stillpoint.datasets.recording import Piece
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import estimate
from stillpoint.filters.run import start_run
from stillpoint.filters.table import ESTIMATORS, SPINS, Estimator

FILTERS = [name for name, entry in ESTIMATORS.items() if isinstance(entry, Estimator)]
STREAMS = ("imu", "mag", "gps", "spin")


def split(recording: Recording, edges_ns: list[int]) -> list[Piece]:
    """The pieces before, between and after some times; one may be without a sample of the IMU."""
    pieces = []
    for start, end in zip([0, *edges_ns], [*edges_ns, 2**62], strict=True):
        streams = {}
        for name in STREAMS:
            if (whole := getattr(recording, name)) is not None:
                first, last = np.searchsorted(whole.t_ns, [start, end])
                streams[name] = slice_stream(whole, int(first), int(last))
        pieces.append(Piece(**streams))
    return pieces


def assert_same_in_pieces(recording: Recording, name: str, edges_ns: list[int], **options) -> None:
    whole, run = estimate(recording, name, **options), start_run(recording.head, name, **options)
    parts = [made for piece in split(recording, edges_ns) if (made := run.add(piece)) is not None]
    assert len(parts) > 2
    last = run.close(parts[-1])
    for field in fields(Estimate):
        column = getattr(whole, field.name)
        if isinstance(column, np.ndarray):
            joined = np.concatenate([getattr(part, field.name) for part in parts])
            assert joined.tobytes() == column.tobytes(), field.name
    for key, value in whole.diagnostics.items():
        same = value if not key.endswith("rms_deg") else pytest.approx(value, rel=1e-12)  # a sum in another order
        assert last.diagnostics[key] == same, key


def edges_of(recording: Recording) -> list[int]:
    """Between two samples of the IMU, at one, within a gap, and between a field and the sample that brings it."""
    t_ns = (recording.imu or recording.spin).t_ns
    longest = int(np.diff(t_ns).argmax())
    edges = {int(t_ns[5]) + 1, int(t_ns[300]), int(t_ns[longest]) + 10, int(t_ns[longest]) + 1_000_000}
    return sorted(edges | {int(t_ns[-40]), int(t_ns[-1]) + 1})


@pytest.mark.parametrize("name", FILTERS)
def test_pieces_give_the_bits_of_the_whole(name):
    recording = untidy()
    assert_same_in_pieces(recording, name, edges_of(recording))


def test_pieces_give_the_bits_of_the_whole_in_single_precision():
    recording = untidy()
    assert_same_in_pieces(recording, "cf", edges_of(recording), precision="single")


def test_fixes_and_fields_of_one_piece_wait_for_the_imu_of_the_next():
    """With satellites the state of the heading source, too, goes from piece to piece; some fixes are never used."""
    recording = untidy()
    t_ns = np.sort(np.concatenate([np.arange(20) * 1_000_000_000 + 7, np.arange(40) * 60_000_000 + 9_100_000_000]))
    t_ns = np.unique(t_ns)
    n = len(t_ns)
    course, speed = np.linspace(0, 3, n), np.full(n, 2.0)
    gps = Gps(t_ns, np.full(n, 48.0), np.full(n, 11.0), np.full(n, 0.0), course, speed, np.arange(n) % 5 > 0)
    recording = replace(recording, gps=gps)
    assert estimate(recording, "cf", heading="gps-course").diagnostics["n_fix_unused"] > 0
    assert_same_in_pieces(recording, "cf", edges_of(recording), heading="gps-course")


@pytest.mark.parametrize("name", SPINS)
def test_a_spin_in_pieces_gives_the_bits_of_the_whole(name):
    recording = simulate("spin-constant", seed=1, sensor=QUIET)
    assert_same_in_pieces(recording, name, edges_of(recording))


def test_what_takes_a_whole_recording_is_refused():
    with pytest.raises(BadParameter, match="takes a whole recording at a time"):
        start_run(untidy().head, "vqf")
    with pytest.raises(BadRecording, match="no accelerometers on a spinning body"):
        start_run(untidy().head, "roll-ekf")
