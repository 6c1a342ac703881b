"""``acc-ma``: the mean of ``acc`` over the last seconds (Elmi Aziz and Mohseni Araste 2021, table 1).

Averaged are the axes of n as the body sees them, never angles: the sum of up and the sum of east over the window, made
orthonormal again. The mean has no wrap, and for attitudes close together it is their mean rotation.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.compiled import compiled, compiled_entry, compiled_inside
from stillpoint.datasets.settings import Settings, number
from stillpoint.filters.complementary import tilt
from stillpoint.filters.rotation import (
    Quaternion,
    Vector,
    add,
    conjugate,
    cross,
    norm,
    quaternion_from_rows,
    rotate,
    scale,
)
from stillpoint.filters.sample import Output, Sample

# Sums shorter than that share of what was summed point nowhere: the attitudes of the window cancel each other.
_LEAST_SUM = 0.01


@dataclass(frozen=True)
class Params(Settings):
    """Parameters of ``acc-ma``."""

    window_s: float = number(7.0, 0.0, 600.0, "length of the moving average, s")
    kappa: float = number(0.7, 0.0, 1.0, "share of the newest raw sample in the low pass (9); 1 = no low pass")
    room_hz: float = number(1000.0, 1.0, 1e4, "fastest rate that the window has room for (faster: shorter window), Hz")


class Coefficients(NamedTuple):
    """Constants derived once from the parameters."""

    tilt: tilt.Coefficients
    window_ns: int
    room: int  # rows of the ring


class Window(NamedTuple):
    """The attitudes of the last seconds. The ring is passed from step to step and written in place."""

    ring: NDArray[np.float64]  # (room, 6) up and east, seen from the body
    stamps_ns: NDArray[np.int64]  # (room,) since the first sample
    oldest: int  # row
    held: int
    up_sum_b: Vector
    east_sum_b: Vector
    is_full: bool
    n_cut: int  # samples for which the ring had no room for the whole window


class State(NamedTuple):
    """The state of the filter between two samples."""

    tilt: tilt.State
    window: Window
    t_ns: int  # since the first sample
    q_nb: Quaternion
    n_no_mean: int  # samples that keep the mean before: the attitudes cancel each other


def coefficients(params: Params, declination_rad: float) -> Coefficients:
    """Precompute the filter's constants from its parameters and the local declination (east of true north)."""
    room = int(params.window_s * params.room_hz) + 2
    return Coefficients(tilt.Coefficients(params.kappa, declination_rad), round(params.window_s * 1e9), room)


@compiled_entry
def start(c: Coefficients) -> State:
    """Return the state before the first sample: level, with the body's x axis pointing east."""
    none = (0.0, 0.0, 0.0)
    window = Window(np.full((c.room, 6), 0.0), np.full(c.room, 0), 0, 0, none, none, False, 0)
    return State(tilt.start(c.tilt), window, 0, (1.0, 0.0, 0.0, 0.0), 0)


@compiled
def _read_row(ring: NDArray[np.float64], row: int) -> tuple[Vector, Vector]:
    """Return up and east of one sample in the window."""
    return (ring[row, 0], ring[row, 1], ring[row, 2]), (ring[row, 3], ring[row, 4], ring[row, 5])


@compiled
def _slide_window(window: Window, q_nb: Quaternion, t_ns: int, c: Coefficients) -> Window:
    """Append one attitude to the window and drop those that are too old."""
    ring, stamps_ns, oldest, held, up_sum, east_sum, is_full, n_cut = window
    while held > 0 and (t_ns - stamps_ns[oldest] >= c.window_ns or held == c.room):
        if t_ns - stamps_ns[oldest] < c.window_ns:
            n_cut += 1
        up, east = _read_row(ring, oldest)
        up_sum, east_sum = add(up_sum, scale(up, -1.0)), add(east_sum, scale(east, -1.0))
        oldest, held, is_full = (oldest + 1) % c.room, held - 1, True
    row, q_bn = (oldest + held) % c.room, conjugate(q_nb)
    up, east = rotate(q_bn, (0.0, 0.0, 1.0)), rotate(q_bn, (1.0, 0.0, 0.0))
    ring[row, 0], ring[row, 1], ring[row, 2] = up
    ring[row, 3], ring[row, 4], ring[row, 5] = east
    stamps_ns[row] = t_ns
    return Window(ring, stamps_ns, oldest, held + 1, add(up_sum, up), add(east_sum, east), is_full, n_cut)


@compiled
def _mean_attitude(window: Window, q_nb: Quaternion) -> tuple[Quaternion, bool]:
    """Return the attitude whose up and east are nearest to the sums; ``q_nb`` and False where these cancel."""
    least = 1.0 * window.held * _LEAST_SUM
    height = norm(window.up_sum_b)
    if height < least:
        return q_nb, False
    up = scale(window.up_sum_b, 1.0 / height)
    north = cross(up, window.east_sum_b)
    length = norm(north)
    if length < least:
        return q_nb, False
    north = scale(north, 1.0 / length)
    return quaternion_from_rows(cross(north, up), north, up), True


@compiled_inside
def step(state: State, sample: Sample, c: Coefficients) -> tuple[State, Output]:
    """Compute ``acc``, then its mean over the window."""
    inner, output = tilt.step(state.tilt, sample, c.tilt)
    t_ns = state.t_ns + round(np.float64(sample.dt_s) * 1e9)
    window, q_nb, n_no_mean = state.window, state.q_nb, state.n_no_mean
    if output.ready:
        window = _slide_window(window, output.q_nb, t_ns, c)
        q_nb, found = _mean_attitude(window, q_nb)
        n_no_mean += 0 if found else 1
    return State(inner, window, t_ns, q_nb, n_no_mean), Output(q_nb, None, None, None, window.is_full)
