"""The factors between neighbouring states, as arrays: IMU, calibration, and bounds of the motion.

There is one of each for every tenth of a second, so they are kept as arrays and linearised together. They have the keys
of gtsam's factors (factors.py), which the elimination joins with them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, M, V, X
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stillpoint.datasets.recording import Floats
from stillpoint.smoother.attitude.factors import CALIBRATION, bias_steps
from stillpoint.smoother.attitude.keys import Keys, Motion
from stillpoint.smoother.attitude.linear.effective import eliminate_effective, find_noise, split_residuals
from stillpoint.smoother.attitude.linear.preintegration import linearise_intervals, preintegrate
from stillpoint.smoother.attitude.linear.rows import Indices, Rows, starts
from stillpoint.smoother.attitude.linear.structure import Structure
from stillpoint.smoother.attitude.params import GraphParams
from stillpoint.smoother.attitude.samples.compound import compound_samples

_EFFECTIVE_BIAS_SD = np.concatenate([np.full(3, 1e-3), np.full(3, 1e-4)])  # keeps C = B + M z soft enough to factorise
_SMALL = 1e-4  # square of an angle, rad^2, below which series replace quotients
_IMU, _CALIBRATION, _SPEED, _PLACE = 9, 6, 3, 3  # rows of each factor


@dataclass(frozen=True, eq=False)
class Chain:
    """Factors of m intervals, and of k states with bounded speed and p states with bounded place."""

    interval: Indices  # (m,) its number
    bias_step: Indices  # (m,) number of the bias that holds in it
    zeta: Floats  # (m, 9) preintegrated turn, place and velocity
    zeta_by_bias: Floats  # (m, 9, 6)
    whitening: Floats  # (m, 9, 9)
    length_s: Floats  # (m,)
    start_bias: Floats  # (m, 6) about which it is preintegrated: accelerometer, gyro
    g_mps2: Floats  # (m,)
    by_matrix: Floats  # (m, 6, 19) derivative of the effective bias by the calibration
    fast: Indices  # (k,) states with bounded speed
    speed_weight: Floats  # (k,) 1 / sd
    placed: Indices  # (p,) states with bounded place
    place_weight: Floats  # (p,)
    explicit: NDArray[np.bool_]  # (m,) the effective bias is an unknown of its own, since other factors have it

    def keys(self) -> Rows:
        """Return rows without data, for their keys."""
        whole, i = self.interval[~self.explicit], self.interval[self.explicit]
        k, m = len(whole), len(i)
        of_states = np.stack([V(0) + whole, X(0) + whole, V(1) + whole, X(1) + whole], axis=1)
        of_whole = np.column_stack([of_states, B(0) + self.bias_step[~self.explicit], np.full(k, M(0))])
        imu = np.stack([X(0) + i, V(0) + i, X(1) + i, V(1) + i, C(0) + i], axis=1)
        calibration = np.stack([C(0) + i, B(0) + self.bias_step[self.explicit], np.full(m, M(0))], axis=1)
        keys = [of_whole.ravel(), imu.ravel(), calibration.ravel(), V(0) + self.fast, X(0) + self.placed]
        counts = [k, m, m, len(self.fast), len(self.placed)]
        return Rows(
            keys=np.concatenate(keys).astype(np.int64),
            key_first=starts(np.repeat([6, 5, 3, 1, 1], counts)),
            count=np.repeat([_IMU, _IMU, _CALIBRATION, _SPEED, _PLACE], counts),
            data=np.empty(0),
        )

    def with_explicit(self, intervals: Sequence[int]) -> "Chain":
        """Return the chain with the effective biases of some intervals as unknowns of their own."""
        return replace(self, explicit=np.isin(self.interval, intervals))


@dataclass(frozen=True, eq=False)
class Place:
    """Where a chain is linearised: values of its unknowns."""

    first: int  # number of the first state
    poses: Floats  # (n, 12) rotation matrix by rows, and place
    velocities: Floats  # (n, 3)
    effective: Floats  # (m, 6) effective bias of each interval of the chain
    biases: Floats  # (K, 6) from step ``first_step`` on
    first_step: int
    calibration: Floats  # (19,)


def build_chain(
    motion: Motion, keys: Keys, bias_b_radps: Floats, g_mps2: float, bounded: bool, params: GraphParams
) -> Chain:
    """Return the factors of a window: IMU about a gyro bias (3,), calibration, bounds of place and speed.

    Place and speed are bounded as those of a hand, a table or a vehicle are; at rest the speed is zero. Where
    satellites show the place (not ``bounded``), only rests are.
    """
    intervals = keys.intervals(~keys.gap)
    measured = compound_samples(motion, keys.row, intervals, bias_b_radps)
    accel_var, gyro_var = _noise(keys, intervals, params)
    integration = params.motion.integration_sd_m_rts**2
    rate = measured.gyro_b_radps - bias_b_radps
    zeta, by_bias, whitening = preintegrate(
        measured.accel_b_mps2, rate, measured.length_s, accel_var, gyro_var, integration
    )
    m = len(intervals)
    by_matrix = np.zeros((m, 6, CALIBRATION))
    for axis in range(3):
        by_matrix[:, axis, 3 * axis : 3 * axis + 3] = keys.accel_b_mps2[intervals]
        by_matrix[:, 3 + axis, 9 + 3 * axis : 12 + 3 * axis] = keys.gyro_b_radps[intervals]
    by_matrix[:, :3, 18] = -keys.jerk_b_mps3[intervals]  # late by d: a_measured(t) = a(t - d) = a - d da/dt

    p, states = params.motion, np.array(keys.states, dtype=np.int64)
    share = 1 / np.sqrt(np.minimum(np.append(keys.span_s, keys.span_s[-1]), 1.0))[states]
    resting = (np.concatenate([[False], keys.at_rest]) | np.concatenate([keys.at_rest, [False]]))[states]
    speed_sd = np.where(resting, p.rest_velocity_sd_mps, p.velocity_sd_mps * share)
    slow = resting | bounded
    return Chain(
        interval=intervals,
        bias_step=bias_steps(keys, params)[intervals],
        zeta=zeta,
        zeta_by_bias=by_bias,
        whitening=whitening,
        length_s=measured.length_s.sum(axis=1),
        start_bias=np.tile(np.concatenate([np.zeros(3), bias_b_radps]), (m, 1)),
        g_mps2=np.full(m, g_mps2),
        by_matrix=by_matrix,
        fast=states[slow],
        speed_weight=1 / speed_sd[slow],
        placed=states[:] if bounded else states[:0],
        place_weight=1 / (p.position_sd_m * share) if bounded else np.empty(0),
        explicit=np.zeros(m, dtype=np.bool_),
    )


def _noise(keys: Keys, intervals: Indices, params: GraphParams) -> tuple[Floats, Floats]:
    """Return the variances (m, 3) of accelerometer and gyro for a second of white noise.

    Readings that are replaced, wrong by a share of their excess, or slow add to them. Where a rest has shown how quiet
    the gyro is, its noise grows from there with the rate.
    """
    p, seconds = params.inertial, keys.span_s[intervals][:, None]
    rest = keys.at_rest[intervals][:, None]
    extra_rad2 = (p.gyro_beyond * keys.gyro_clipped_rad[intervals]) ** 2 + keys.gyro_sampling_rad[intervals] ** 2
    extra_mps2 = (p.accel_beyond * keys.accel_clipped_mps[intervals]) ** 2
    own = (keys.clipped[intervals] | (keys.gyro_sampling_rad[intervals] > 0).any(axis=1))[:, None]
    moving = np.full(len(intervals), p.gyro_radps_rthz)
    if keys.at_rest.any():
        by_rate = p.gyro_per_rate_rthz * keys.rate_rms_radps[intervals]
        moving = np.minimum(np.hypot(p.gyro_rest_radps_rthz, by_rate), p.gyro_radps_rthz)
    gyro = np.where(rest & ~own, p.gyro_rest_radps_rthz, moving[:, None]) ** 2 + extra_rad2 / seconds
    accel = np.where(rest & ~own, p.accel_rest_mps2_rthz, p.accel_mps2_rthz) ** 2 + extra_mps2 / seconds
    return accel, gyro


def join_chains(chains: Sequence[Chain]) -> Chain:
    """Return the factors of several stretches of states as one."""
    if len(chains) == 1:
        return chains[0]
    return Chain(**{each.name: np.concatenate([getattr(one, each.name) for one in chains]) for each in fields(Chain)})


def read_place(chain: Chain, values: gtsam.Values, effective: Floats, states: range) -> Place:
    """Return the values of a chain's unknowns; ``effective`` (m, 6) are its effective biases."""
    steps = range(int(chain.bias_step.min()), int(chain.bias_step.max()) + 1) if len(chain.bias_step) else range(0)
    return Place(
        first=states.start,
        poses=poses_of(values, states),
        velocities=_velocities_of(values, states),
        effective=effective,
        biases=np.array([values.atConstantBias(B(k)).vector() for k in steps]).reshape(-1, 6),
        first_step=steps.start,
        calibration=values.atVector(M(0)),
    )


def linearise_chain(chain: Chain, place: Place, more: int = 0) -> Floats:
    """Return the data of the chain's rows at a place, in the order of :meth:`Chain.keys`, and room for more behind."""
    begin = chain.interval - place.first
    poses, velocities = place.poses, place.velocities
    imu = linearise_intervals(
        chain.zeta,
        chain.zeta_by_bias,
        chain.whitening,
        chain.length_s,
        place.effective - chain.start_bias,
        chain.g_mps2,
        (poses[begin], poses[begin + 1]),
        (velocities[begin], velocities[begin + 1]),
    )
    data = np.empty(sum(int(np.prod(shape)) for shape in _shapes(chain)) + more)
    whole, alone, calibration, speed, bound = _split_rows(chain, data)
    by_matrix, excess = chain.by_matrix, _compute_excess(chain, place)
    if len(alone):
        alone[:], imu = imu[chain.explicit], imu[~chain.explicit]
        _fill_calibration(calibration, by_matrix[chain.explicit], excess[chain.explicit])
        by_matrix, excess = by_matrix[~chain.explicit], excess[~chain.explicit]
    eliminate_effective(imu, by_matrix, excess, _EFFECTIVE_BIAS_SD**2, whole)
    speed[:, :, :3] = np.eye(3) * chain.speed_weight[:, None, None]
    speed[:, :, 3] = -chain.speed_weight[:, None] * velocities[chain.fast - place.first]
    where = poses[chain.placed - place.first]
    bound[:, :, :3] = 0.0  # a step in body axes moves the place by R times it
    bound[:, :, 3:6] = chain.place_weight[:, None, None] * where[:, :9].reshape(-1, 3, 3)
    bound[:, :, 6] = -chain.place_weight[:, None] * where[:, 9:]
    return data


def _fill_calibration(rows: Floats, by_matrix: Floats, excess: Floats) -> None:
    """Write the factors C - B - M z = 0 (m, 6, 12 + 19 + 1) of effective biases that are unknowns."""
    weight = 1 / _EFFECTIVE_BIAS_SD
    rows[:, :, :6] = np.diag(weight)
    rows[:, :, 6:12] = -np.diag(weight)
    rows[:, :, 12:-1] = -(by_matrix * weight[:, None])
    rows[:, :, -1] = -weight * excess


@dataclass(frozen=True, eq=False)
class ChainSquares:
    """Squares of the normalised residuals of a chain's factors."""

    imu: Floats  # (m,)
    speed: Floats  # (k,)
    place: Floats  # (p,)
    calibration: Floats  # (m,) where the effective bias is eliminated, that of the best one, as is ``imu``


def split_squares(chain: Chain, data: Floats) -> ChainSquares:
    """Return the squared residuals in the data of the chain's rows."""
    whole, imu, calibration, speed, place = _split_rows(chain, data)
    of_imu, of_calibration = np.empty(len(chain.interval)), np.empty(len(chain.interval))
    of_imu[~chain.explicit], of_calibration[~chain.explicit] = split_residuals(whole, _EFFECTIVE_BIAS_SD**2)
    of_imu[chain.explicit], of_calibration[chain.explicit] = _square(imu), _square(calibration)
    return ChainSquares(of_imu, _square(speed), _square(place), of_calibration)


def _square(rows: Floats) -> Floats:
    """Return the squared residuals (m,) of factors (m, rows, columns)."""
    return np.asarray((rows[:, :, -1] ** 2).sum(axis=1))


def _shapes(chain: Chain) -> list[tuple[int, int, int]]:
    """Return the shapes of the rows of IMU with calibration, IMU alone, calibration alone, speed, and place."""
    k = int(chain.explicit.sum())
    return [
        (len(chain.interval) - k, _IMU, 24 + CALIBRATION + 1),
        (k, _IMU, 25),
        (k, _CALIBRATION, 13 + CALIBRATION),
        (len(chain.fast), _SPEED, 4),
        (len(chain.placed), _PLACE, 7),
    ]


def _split_rows(chain: Chain, data: Floats) -> list[Floats]:
    """Return views of the rows of each kind."""
    shapes = _shapes(chain)
    begin = starts([int(np.prod(shape)) for shape in shapes])
    return [data[begin[k] : begin[k + 1]].reshape(shape) for k, shape in enumerate(shapes)]


@dataclass(frozen=True, eq=False)
class StepPlaces:
    """Where a step (D,) has the changes of the chain's unknowns."""

    whole: Indices  # (k, 24 + 19) of states, bias and calibration of intervals whose effective bias is eliminated
    effective: Indices  # (m - k, 6) effective biases that are unknowns
    poses: Indices  # (n, 6) of the states
    velocities: Indices  # (n, 3), D where no factor has the velocity
    biases: Indices  # (K, 6)
    calibration: Indices  # (19,)


def find_step_places(chain: Chain, place: Place, structure: Structure) -> StepPlaces:
    """Return where the changes of the chain's unknowns stand in a step."""
    states = place.first + np.arange(len(place.poses))
    velocities = np.full((len(states), 3), structure.first[-1])
    has_velocity = structure.has(V(0) + states)
    velocities[has_velocity] = structure.scalars(V(0) + states[has_velocity], 3)
    i, step = chain.interval[~chain.explicit], chain.bias_step[~chain.explicit]
    parts = [(V(0) + i, 3), (X(0) + i, 6), (V(1) + i, 3), (X(1) + i, 6), (B(0) + step, 6), (M(0) + 0 * i, CALIBRATION)]
    whole = [structure.scalars(keys, size) for keys, size in parts]
    explicit = structure.scalars(C(0) + chain.interval[chain.explicit], 6)
    return StepPlaces(
        whole=np.concatenate(whole, axis=1),
        effective=explicit,
        poses=structure.scalars(X(0) + states, 6),
        velocities=velocities,
        biases=structure.scalars(B(place.first_step) + np.arange(len(place.biases)), 6),
        calibration=structure.scalars([M(0)], CALIBRATION)[0],
    )


def move_place(place: Place, step: Floats, places: StepPlaces) -> Place:
    """Return the place after a step (D,) as gtsam adds it to values, with unchanged effective biases."""
    step = np.append(step, 0.0)
    turn, moved = step[places.poses[:, :3]], step[places.poses[:, 3:]]
    rotations = place.poses[:, :9].reshape(-1, 3, 3)
    where = place.poses[:, 9:] + np.einsum("kij,kj->ki", rotations, _push(turn, moved))
    rotations = rotations @ Rotation.from_rotvec(turn).as_matrix()
    return replace(
        place,
        poses=np.concatenate([rotations.reshape(-1, 9), where], axis=1),
        velocities=place.velocities + step[places.velocities],
        biases=place.biases + step[places.biases],
        calibration=place.calibration + step[places.calibration],
    )


def find_change(before: Place, after: Place) -> tuple[Floats, Floats]:
    """Return the steps of the poses (n, 6) and velocities (n, 3) by which gtsam moves from one place to another."""
    back = before.poses[:, :9].reshape(-1, 3, 3).transpose(0, 2, 1)
    turn = Rotation.from_matrix(back @ after.poses[:, :9].reshape(-1, 3, 3)).as_rotvec()
    apart = np.einsum("kij,kj->ki", back, after.poses[:, 9:] - before.poses[:, 9:])
    along = np.stack([_push(turn, np.broadcast_to(axis, turn.shape)) for axis in np.eye(3)], axis=2)
    moved = np.linalg.solve(along, apart[:, :, None])[:, :, 0]
    return np.concatenate([turn, moved], axis=1), after.velocities - before.velocities


def _push(turn: Floats, moved: Floats) -> Floats:
    """Return by how much the exponential of steps (n, 3) moves the place, in the axes at its beginning."""
    square = (turn**2).sum(axis=1)[:, None]
    small = square < _SMALL
    angle = np.sqrt(np.where(small, 1.0, square))
    once = np.where(small, 0.5 - square / 24, (1 - np.cos(angle)) / angle**2)
    twice = np.where(small, 1 / 6 - square / 120, (angle - np.sin(angle)) / angle**3)
    across = np.cross(turn, moved)
    return np.asarray(moved + once * across + twice * np.cross(turn, across))


def step_effective(chain: Chain, place: Place, data: Floats, step: Floats, places: StepPlaces) -> Floats:
    """Return the change (m, 6) of the effective biases that belongs to a step (D,) of the rows with this data."""
    change = np.empty((len(chain.interval), 6))
    change[chain.explicit] = step[places.effective]
    of_whole, whole = step[places.whole], ~chain.explicit
    noise = find_noise(_split_rows(chain, data)[0], of_whole, _EFFECTIVE_BIAS_SD**2)
    by_calibration = (chain.by_matrix[whole] @ of_whole[:, 24:, None])[:, :, 0]
    change[whole] = of_whole[:, 18:24] + by_calibration + noise - _compute_excess(chain, place)[whole]
    return change


def _compute_excess(chain: Chain, place: Place) -> Floats:
    """Return C - B - M z (m, 6) of all intervals."""
    bias = place.biases[chain.bias_step - place.first_step]
    return np.asarray(place.effective - bias - chain.by_matrix @ place.calibration)


def poses_of(values: gtsam.Values, states: Sequence[int] | Indices) -> Floats:
    """Return the poses (K, 12) of states: rotation matrix by rows, and place."""
    poses = gtsam.utilities.extractPose3(values)  # in the order of their keys: a common pose L comes before all X
    last = gtsam.Symbol(values.keys()[-1]).index()  # the states follow each other, and no letter comes after X
    return np.ascontiguousarray(poses[np.asarray(states) - last - 1])


def _velocities_of(values: gtsam.Values, states: Sequence[int] | Indices) -> Floats:
    """Return the velocities (K, 3) of states, whose numbers follow each other."""
    velocities = gtsam.utilities.extractVectors(values, "v")
    last = gtsam.Symbol(values.keys()[-1]).index()
    return np.ascontiguousarray(velocities[np.asarray(states) - last - 1])
