"""Simulate the experiments of Elmi Aziz and Mohseni Araste (2021): a phone that returns to its base pose."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.frames import from_euler, rotation
from stillpoint.datasets.recording import Floats, Recording
from stillpoint.datasets.simulate.generators import make_generator
from stillpoint.datasets.simulate.path import Path, join_strokes
from stillpoint.datasets.simulate.record import Order, Scene, record_path
from stillpoint.datasets.simulate.sensor import Sensor

# The north of Tehran, where the paper was written, on the day on which the journal received it.
_TEHRAN = Scene((35.80, 51.49, 1600.0), "2021-06-12T08:00:00+00:00")
_BASE_EULER_NWU_DEG = (0.4, -0.3, 40.0)  # a table that is nearly level; the phone's x axis points 40 deg east of north

_SWING_S = (20.0, 30.0)
_RETURN_S = (3.0, 6.0)
_SHORTEST_TURN_S = 0.15
_SHORTEST_REACH_S = 0.06


@dataclass(frozen=True)
class Hand:
    """How a hand moves the phone: strokes to turns and places drawn from a box around the base pose, with jolts.

    Triples are for the axes of the base pose. Peak rate and peak acceleration of a stroke are drawn between the two
    given values, their logarithm uniform; they set how long the stroke takes. Jolts are small, short strokes on top of
    the others: the stick and slip of sliding, the shaking of a hand.
    """

    initial_rest_s: float
    turn_deg: tuple[float, float, float]  # half the sides of the box
    peak_rate_degps: tuple[float, float]
    reach_m: tuple[float, float, float]  # half the sides of the box
    peak_accel_mps2: tuple[float, float]
    jolt_m: tuple[float, float, float]  # half the sides of the box
    jolt_accel_mps2: tuple[float, float]
    return_turn_deg: tuple[float, float, float] = (0.2, 0.2, 0.2)  # sd: how well the base pose is found again
    return_reach_m: float = 0.002  # sd
    arm_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # from the point about which the phone turns to its IMU


SLIDING = Hand(
    initial_rest_s=10.0,
    turn_deg=(0.0, 0.0, 120.0),
    peak_rate_degps=(20.0, 400.0),
    reach_m=(0.35, 0.35, 0.0),
    peak_accel_mps2=(0.1, 0.4),
    jolt_m=(0.01, 0.01, 0.0),
    jolt_accel_mps2=(0.2, 5.5),
    return_turn_deg=(0.0, 0.0, 0.2),
)
# The head of a tripod turns the phone about a point below it: what accelerates its IMU is the lever arm. Holder and
# plate of a photo tripod put a phone some 12 cm above that point; the IMU sits a few centimetres from its middle.
TRIPOD = Hand(
    initial_rest_s=60.0,
    turn_deg=(40.0, 40.0, 90.0),
    peak_rate_degps=(15.0, 90.0),
    reach_m=(0.0, 0.0, 0.0),
    peak_accel_mps2=(0.1, 0.4),
    arm_b_m=(0.05, 0.02, 0.12),
    jolt_m=(0.001, 0.001, 0.001),
    jolt_accel_mps2=(0.02, 0.2),
)
IN_HAND = Hand(
    initial_rest_s=60.0,
    turn_deg=(60.0, 45.0, 90.0),
    peak_rate_degps=(100.0, 800.0),
    reach_m=(0.3, 0.3, 0.2),
    peak_accel_mps2=(0.5, 4.0),
    jolt_m=(0.03, 0.03, 0.03),
    jolt_accel_mps2=(2.0, 20.0),
)
# Held in one place and shaken evenly, about as fast as a hand can: half of the acceleration's power lies above 5 Hz,
# half a percent below 1 Hz. IN_HAND is carried about as well (4 %), and its jolts go from weak to fierce, up to 2 g,
# where the measured gravity turns over. `Acc` is about as wrong with either as in the paper.
SHAKEN = replace(
    IN_HAND,
    reach_m=(0.1, 0.1, 0.1),
    peak_accel_mps2=(0.2, 1.0),
    jolt_m=(0.015, 0.015, 0.015),
    jolt_accel_mps2=(6.0, 9.0),
)
# The same to the sides, not up and down. A shake a to the side is measured as the tilt a / (g + a_up), whose mean is
# not zero where a_up changes with it: a slow error, however fast the shake.
LEVEL = replace(SHAKEN, jolt_m=(0.015, 0.015, 0.0))


def simulate_experiment(kind: str, hand: Hand, sensor: Sensor, seed: int, minutes: float, rate_hz: float) -> Recording:
    """Simulate one experiment. Raises :class:`BadParameter` when ``minutes`` leave no room for a swing."""
    path = draw_path(hand, minutes * 60, seed, kind)
    facts = {"motion": asdict(hand), "rests_s": path.rests_s.tolist()}
    recording = record_path(path, sensor, _TEHRAN, Order(kind, seed, minutes, rate_hz), facts)
    return replace(recording, base_pose=path.base_q_nb)


def draw_path(hand: Hand, total_s: float, seed: int, kind: str) -> Path:
    """Return the path of one experiment: a rest, then swings that end in the base pose."""
    rests = plan_rests(hand.initial_rest_s, total_s, seed, kind)
    turn_box, reach_box = np.deg2rad(hand.turn_deg), np.asarray(hand.reach_m)
    turn_s = partial(_turn_s, np.deg2rad(hand.peak_rate_degps))
    reach_s, jolt_s = partial(_find_reach_s, hand.peak_accel_mps2), partial(_find_reach_s, hand.jolt_accel_mps2)
    start = (0.0, np.zeros(3))
    turns, places, jolts = [start], [start], [start]
    for swing, (rest, following) in enumerate(pairwise(rests)):
        span_s = float(rest[1]), float(following[0])
        rng = make_generator(seed, f"{kind}/swing/{swing}")
        home_turn = np.deg2rad(rng.standard_normal(3) * hand.return_turn_deg)
        home_place = rng.standard_normal(3) * hand.return_reach_m * (reach_box > 0)
        turns += _swing(span_s, turns[-1][1], home_turn, turn_box, turn_s, rng)
        places += _swing(span_s, places[-1][1], home_place, reach_box, reach_s, rng)
        jolts += _swing(span_s, np.zeros(3), np.zeros(3), np.asarray(hand.jolt_m), jolt_s, rng)
    for chain in (turns, places, jolts):
        chain.append((total_s, chain[-1][1]))
    base_q_nb = from_euler(np.deg2rad(_BASE_EULER_NWU_DEG), "nwu")
    base = rotation(base_q_nb)
    in_n = tuple(join_strokes([t for t, _ in chain], base.apply([at for _, at in chain])) for chain in (places, jolts))
    return Path(base_q_nb, join_strokes(*zip(*turns, strict=True)), in_n, rests, hand.arm_b_m)


def plan_rests(initial_rest_s: float, total_s: float, seed: int, kind: str) -> Floats:
    """Return the rests (R, 2) in s: one at first, then one after each swing of 20-30 s; the last takes what is left."""
    rng = make_generator(seed, f"{kind}/protocol")
    rests = [[0.0, initial_rest_s]]
    while total_s - rests[-1][1] >= _SWING_S[0] + _RETURN_S[0]:
        left = total_s - rests[-1][1]
        swing = min(rng.uniform(*_SWING_S), left - _RETURN_S[0])
        rest = min(rng.uniform(*_RETURN_S), left - swing)
        start = rests[-1][1] + swing
        rests.append([start, start + rest])
    if len(rests) == 1:
        shortest = (initial_rest_s + _SWING_S[0] + _RETURN_S[0]) / 60
        raise BadParameter(f"minutes {total_s / 60:g}: {kind} needs at least {shortest:.2f}, a rest and one swing")
    rests[-1][1] = total_s
    return np.array(rests)


def _swing(
    span_s: tuple[float, float],
    value: Floats,
    home: Floats,
    box: Floats,
    stroke_s: Callable[[Floats, float], float],
    rng: np.random.Generator,
) -> list[tuple[float, Floats]]:
    """Return the ends of the strokes of one swing, which leaves from ``value`` and is ``home`` at the end of its span.

    ``stroke_s(way, speed)`` is how long a stroke takes; ``speed`` in [0, 1] is from the slowest to the fastest. Strokes
    follow one another until not even a fast one fits. The way home is slow, as a hand is that puts something down.
    """
    start_s, end_s = span_s
    ends = [(start_s, value)]
    while True:
        target = rng.uniform(-1, 1, 3) * box
        at_s, way, last_s = ends[-1][0], target - ends[-1][1], stroke_s(home - target, 0.3)
        fitting = [speed for speed in (rng.uniform(), 1.0) if at_s + stroke_s(way, speed) + last_s <= end_s]
        if not fitting:
            return [*ends, (end_s, home)]
        ends.append((at_s + stroke_s(way, fitting[0]), target))


def _turn_s(rate_radps: Floats, way_rad: Floats, speed: float) -> float:
    """Return the time of a minimum-jerk turn, whose rate peaks at 15/8 of its mean."""
    slowest, fastest = rate_radps
    return max(_SHORTEST_TURN_S, 15 / 8 * float(np.linalg.norm(way_rad)) / (slowest ** (1 - speed) * fastest**speed))


def _find_reach_s(accel_mps2: tuple[float, float], way_m: Floats, speed: float) -> float:
    """Return the time of a minimum-jerk stroke, whose acceleration peaks at 10/sqrt(3) of its way over its time
    squared.
    """
    slowest, fastest = accel_mps2
    peak = slowest ** (1 - speed) * fastest**speed
    return max(_SHORTEST_REACH_S, float(np.sqrt(10 / np.sqrt(3) * np.linalg.norm(way_m) / peak)))
