"""Gaps in the stamps: short islands are left out and reported, and no pattern of gaps reaches native code."""

import subprocess
import sys
import textwrap
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from stillpoint.datasets import Imu, Unobservable
from stillpoint.datasets.simulate import simulate
from stillpoint.scoring import score
from stillpoint.smoother import reference
from stillpoint.smoother.attitude.keys import choose_keys, prepare_motion
from stillpoint.smoother.attitude.params import KeyParams
from stillpoint.smoother.attitude.windows import split_windows
from stillpoint.smoother.stretches import SHORTEST_STRETCH_S, leave_out_islands


@pytest.fixture(scope="module")
def hand():
    return simulate("phone-3", seed=1, minutes=1.5, rate_hz=50)


def keep(recording, rows):
    imu = recording.imu
    return replace(recording, imu=Imu(imu.t_ns[rows], imu.gyro_b_radps[rows], imu.accel_b_mps2[rows]))


def seconds(recording):
    return (recording.imu.t_ns - recording.imu.t_ns[0]) / 1e9


def delay_last(recording, by_s):
    imu = recording.imu
    t_ns = imu.t_ns.copy()
    t_ns[-1] += round(by_s * 1e9)
    return replace(recording, imu=Imu(t_ns, imu.gyro_b_radps, imu.accel_b_mps2))


@pytest.mark.slow
def test_a_late_last_sample_is_left_out_and_reported(hand):
    late = delay_last(hand, 0.6)
    made = reference(late)
    assert len(made.t_ns) == len(hand.imu.t_ns) - 1
    (island,) = made.diagnostics["left_out"]
    assert island["samples"] == 1
    assert island["length_s"] == 0.0
    assert island["start_s"] == pytest.approx(seconds(late)[-1])
    assert score(made, hand.truth).total_rmse_deg < 1.5 * score(reference(hand), hand.truth).total_rmse_deg


@pytest.mark.slow
def test_a_lone_sample_between_two_gaps_is_left_out(hand):
    t_s = seconds(hand)
    lone = keep(hand, (t_s < 20) | (np.abs(t_s - 25) < 0.01) | (t_s > 30))
    made = reference(lone)
    (island,) = made.diagnostics["left_out"]
    assert island["start_s"] == pytest.approx(25.0, abs=0.05)
    assert len(made.t_ns) == len(lone.imu.t_ns) - island["samples"]


def test_a_recording_without_gaps_is_returned_as_it_is(hand):
    whole, islands = leave_out_islands(hand)
    assert whole is hand
    assert islands == ()


def test_a_stretch_that_is_long_enough_stays(hand):
    t_s = seconds(hand)
    tail = keep(hand, (t_s < 60) | (t_s > t_s[-1] - 2 * SHORTEST_STRETCH_S))
    whole, islands = leave_out_islands(tail)
    assert whole is tail
    assert islands == ()


def test_nothing_but_islands_is_refused_with_their_length(hand):
    pieces = keep(hand, np.floor(seconds(hand) / 0.3) % 4 == 0)
    with pytest.raises(Unobservable, match=r"gaps cut gyro and accelerometer into \d+ pieces, the longest of 0\.\d+ s"):
        reference(pieces)


def test_windows_stay_linked_over_a_gap_longer_than_a_window():
    """Each window but the last ends after the next begins, so that it hands its past over."""
    t_s = np.concatenate([np.arange(0, 300, 0.05), 9000 + np.arange(0, 300, 0.05)])
    still = np.zeros((len(t_s), 3))
    imu = Imu(np.round(t_s * 1e9).astype(np.int64), still, still + np.array([0.0, 0.0, 9.81]))
    keys = choose_keys(prepare_motion(imu, np.empty((0, 2), dtype=np.int64)), KeyParams())
    windows = split_windows(keys, KeyParams(window_s=600.0))
    assert len(windows) > 1
    assert windows[-1][1:] == (len(keys.t_s), len(keys.t_s))
    for (first, until, end), (following, *_) in pairwise(windows):
        assert first < until == following < end


IN_ANOTHER_PROCESS = """
    import sys
    from dataclasses import replace
    import numpy as np
    from stillpoint.datasets import Imu, StillpointError
    from stillpoint.datasets.simulate import simulate
    from stillpoint.smoother import reference
    from stillpoint.smoother.attitude.params import PRESETS

    whole = {"hand": simulate("phone-3", seed=1, minutes=1.5, rate_hz=25)}
    whole["sea"] = simulate("auv-dolphin-calm", seed=1, minutes=6, rate_hz=10)
    for seed in map(int, sys.argv[1:]):
        draw = np.random.default_rng(seed)
        kind = str(draw.choice(["hand", "sea"]))
        recording, imu = whole[kind], whole[kind].imu
        first = draw.integers(0, len(imu.t_ns) // 2)
        rows = np.arange(first, first + draw.integers(200, 800))
        t_ns = imu.t_ns[rows].copy()
        there = np.ones(len(rows), dtype=bool)
        for _ in range(draw.integers(0, 8)):
            start_ns = draw.uniform(t_ns[0], t_ns[-1])
            there &= (t_ns < start_ns) | (t_ns > start_ns + draw.choice([0.3, 0.6, 1.5, 8.0]) * 1e9)
        for _ in range(draw.integers(0, 3)):
            t_ns[draw.integers(1, len(t_ns)) :] += round(draw.choice([0.55, 3.0, 85.0, 4000.0]) * 1e9)
        if draw.random() < 0.5:
            t_ns[-1] += 600_000_000
        rows, t_ns = rows[there], t_ns[there]
        cut = Imu(t_ns, imu.gyro_b_radps[rows], imu.accel_b_mps2[rows])
        mag, gps = (stream if draw.random() < 0.6 else None for stream in (recording.mag, recording.gps))
        params = PRESETS["handheld" if kind == "hand" else "vehicle"]
        try:
            made = reference(replace(recording, imu=cut, mag=mag, gps=gps), params=params)
        except StillpointError as error:
            print(seed, "refused:", error)
        else:
            left_out = sum(island["samples"] for island in made.diagnostics["left_out"])
            assert len(made.t_ns) + left_out == len(t_ns), seed
            print(seed, "made")
"""


@pytest.mark.slow
def test_random_gaps_end_in_a_reference_or_one_line():
    """In another process: a segmentation fault or an abort of native code would otherwise end the tests."""
    seeds = range(8)
    command = [sys.executable, "-c", textwrap.dedent(IN_ANOTHER_PROCESS), *map(str, seeds)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    lines = done.stdout.splitlines()
    assert len(lines) == len(seeds)
    assert any(line.endswith("made") for line in lines)
