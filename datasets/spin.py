"""Model what accelerometers on a spinning body measure, and derive the spin from them (Asghari et al. 2018, section
2).

The body spins about its x axis. :func:`compute_specific_force` is eq (1). :func:`channels` turns any
:class:`SpinGeometry` into the observations of the angular acceleration and of the squared rate about x, the paper's
eqs (4), (5), (25)-(27) for its five accelerometers and two gyros and for its bench of two, by the best linear unbiased
estimate of the terms of eq (1).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.errors import BadParameter, Unobservable
from stillpoint.datasets.recording import Floats, Spin, SpinGeometry

# The terms that eq (1) is linear in, with the coefficients of :func:`coefficients`, in this order.
TERMS = (
    "A_x", "A_y", "A_z", "omega_x dot", "omega_y dot", "omega_z dot",
    "omega_x^2", "omega_y^2", "omega_z^2", "omega_x omega_y", "omega_x omega_z", "omega_y omega_z",
)  # fmt: skip
_CENTRE = TERMS[:3]  # the specific force at the centre
_PRODUCTS = ("omega_y^2", "omega_z^2", "omega_y omega_z")  # known where gyros measure omega_y and omega_z
_UNWANTED = ("omega_y dot", "omega_z dot", "omega_x omega_y", "omega_x omega_z")  # what eq (2) keeps out
_NEGLIGIBLE = 1e-9  # m or 1: coefficients below it are rounding
SATURATED = 0.999  # of the range: a converter of 11 bits and more stops within this of it

_X, _Y, _Z = np.eye(3)


def make_five_accelerometers(
    d1_m: float = 0.10, d2_m: float = 0.50, accel_range_mps2: float = 16 * STANDARD_GRAVITY_MPS2
) -> SpinGeometry:
    """Return the geometry with F1, F2, F3 along x, y, z at the centre, F4 radial at d1, F5 tangential at d2, and gyros
    g1, g2 about y and z.
    """
    return SpinGeometry(
        accel_r_b_m=np.array([0 * _X, 0 * _X, 0 * _X, d1_m * _Z, d2_m * _Y]),
        accel_axis_b=np.array([_X, _Y, _Z, _Z, _Z]),
        gyro_axis_b=np.array([_Y, _Z]),
        accel_range_mps2=np.full(5, accel_range_mps2),
    )


def bench(d1_m: float = 0.10, d2_m: float = 0.50, accel_range_mps2: float = 16 * STANDARD_GRAVITY_MPS2) -> SpinGeometry:
    """Return the geometry of F4 and F5 on the shaft of a motor, whose centre does not accelerate (Asghari et al. 2018,
    eq (26)).
    """
    return SpinGeometry(
        accel_r_b_m=np.array([d1_m * _Z, d2_m * _Y]),
        accel_axis_b=np.array([_Z, _Z]),
        gyro_axis_b=np.empty((0, 3)),
        accel_range_mps2=np.full(2, accel_range_mps2),
        fixed_axis=True,
    )


FIVE_ACCELEROMETERS = make_five_accelerometers()
BENCH = bench()


def compute_specific_force(r_b_m: Floats, centre_b_mps2: Floats, rate_radps: Floats, accel_radps2: Floats) -> Floats:
    """Return the specific force (..., 3) in m/s^2 at a point of the body, eq (1) in full: A + w' x r + w x (w x r).

    ``r_b_m`` is the point's lever arm from the centre, ``centre_b_mps2`` the specific force A there, ``rate_radps`` and
    ``accel_radps2`` the body's angular rate w and its derivative w', all in b; they broadcast against each other.
    """
    inward = np.cross(rate_radps, np.cross(rate_radps, r_b_m))
    return np.asarray(centre_b_mps2 + np.cross(accel_radps2, r_b_m) + inward)


def coefficients(geometry: SpinGeometry) -> Floats:
    """Return how much of each of :data:`TERMS` each accelerometer measures, (k, 12): eq (1) along its axis, with its
    signs.
    """
    r, s = geometry.accel_r_b_m, geometry.accel_axis_b
    turning = np.cross(r, s)  # s . (w' x r) = w' . (r x s)
    squares = s * r - np.sum(s * r, axis=1, keepdims=True)  # s . (w (w . r) - r |w|^2)
    mixed = [s[:, a] * r[:, b] + s[:, b] * r[:, a] for a, b in ((0, 1), (0, 2), (1, 2))]
    return np.column_stack([s, turning, squares, *mixed])


def find_misplaced(geometry: SpinGeometry) -> tuple[str, ...]:
    """Return a sentence for each accelerometer that breaks eq (2), that is, measures a term that no gyro gives; ()
    when none does.
    """
    if geometry.fixed_axis:
        return ()
    seen = np.abs(coefficients(geometry)[:, [TERMS.index(term) for term in _UNWANTED]]) > _NEGLIGIBLE
    sentences = []
    for k, terms in enumerate(seen):
        if not terms.any():
            continue
        names = ", ".join(term for term, one in zip(_UNWANTED, terms, strict=True) if one)
        ways = []
        if abs(geometry.accel_r_b_m[k, 0]) > _NEGLIGIBLE:
            ways.append("move it into the y-z plane (r_x = 0)")
        if abs(geometry.accel_axis_b[k, 0]) > _NEGLIGIBLE:
            ways.append("turn its axis square to x (theta_x = 90 deg)")
        sentences.append(f"accelerometer {k + 1} sees {names}: {' and '.join(ways)}")
    return tuple(sentences)


@dataclass(frozen=True, eq=False)
class Channel:
    """One quantity from the columns of a :class:`Spin`: ``accel @ F + products @ (w_y^2, w_z^2, w_y w_z)``."""

    term: str  # of TERMS
    accel: Floats  # (k,) weights of the accelerometers; 0 for one that is not used
    products: Floats  # (3,) weights of PRODUCTS, from the gyros
    variance: float  # by the variances of the accelerometers; (1/s^2)^2 for rates and accelerations

    def value(self, accel_mps2: Floats, transverse_radps: Floats) -> Floats:
        """Return the quantity (N,) from accelerometers (N, k) and the rates about y and z (N, 2), row by row.

        Column by column, not as a matrix product: that would round a row by how many rows there are.
        """
        y, z = transverse_radps.T
        total = np.zeros(len(accel_mps2))
        for k in np.flatnonzero(self.accel):  # a NaN in a column without weight has no effect
            total += self.accel[k] * accel_mps2[:, k]
        for weight, product in zip(self.products, (y * y, z * z, y * z), strict=True):
            total += weight * product if weight else 0.0
        return total


@dataclass(frozen=True, eq=False)
class SpinChannels:
    """The two observations of the spin that a geometry gives: weights of its columns, and their variances."""

    geometry: SpinGeometry
    omega_dot: Channel  # angular acceleration about x, rad/s^2; its variance is the paper's Q
    omega_squared: Channel  # squared rate about x, rad^2/s^2; its variance is the paper's R
    omega_xy: Channel | None  # omega_x omega_y: its sign against omega_y's is that of omega_x; None where not seen
    omega_xz: Channel | None  # omega_x omega_z likewise
    spare_dot: tuple[Channel | None, ...]  # (k,) omega_dot without accelerometer k; None where the others lack it
    spare_squared: tuple[Channel | None, ...]  # (k,) omega_squared likewise
    transverse: Floats  # (2, m) weights of the gyros that give omega_y and omega_z; 0 where none does
    misplaced: tuple[str, ...]  # what breaks eq (2); not in the way where enough accelerometers are there

    @property
    def q_rad2ps4(self) -> float:
        """Return Q of eq (25): the variance of the angular acceleration."""
        return self.omega_dot.variance

    @property
    def r_rad2ps4(self) -> float:
        """Return R of eq (25): the variance of the squared rate."""
        return self.omega_squared.variance


@dataclass(frozen=True, eq=False)
class SpinSamples:
    """Both observations at every sample of a :class:`Spin`; ``valid`` is False where an input is NaN or saturated."""

    omega_dot_radps2: Floats  # (N,)
    omega_squared_radps2: Floats  # (N,) rad^2/s^2, negative where noise is larger than the rate
    omega_dot_valid: NDArray[np.bool_]  # (N,)
    omega_squared_valid: NDArray[np.bool_]  # (N,)


def channels(geometry: SpinGeometry, accel_variance_m2ps4: ArrayLike = 1.0) -> SpinChannels:
    """Return the observations of the spin for the accelerometers' noise variances D (k,), or one for all, in
    (m/s^2)^2.

    Weights are those of least variance among all that are free of every other term of eq (1). The products of omega_y
    and omega_z are known where the gyros give both rates, and their noise counts as none, as in the paper. On a fixed
    axis there are no such rates, and a specific force at the centre (gravity) counts as zero where no accelerometer
    shows it. Raises :class:`Unobservable` with what to change where the geometry does not fix the two, and
    :class:`BadParameter` for variances that are not positive.
    """
    k = len(geometry.accel_r_b_m)
    unknown = np.flatnonzero(np.isnan(geometry.accel_r_b_m).any(axis=1)) + 1
    if len(unknown):
        raise Unobservable(
            f"the lever arm of accelerometer {', '.join(map(str, unknown))} is not known: measure it and write it into "
            "the geometry; or, beside an encoder or the angle of a gyro, write a guess and let roll-graph find the "
            "length, by encoder.use=true and a wide calibration.lever_arm_sd (docs/roll.md, A disc in flight)"
        )
    variance = np.broadcast_to(np.asarray(accel_variance_m2ps4, dtype=np.float64), (k,))
    if not (np.isfinite(variance) & (variance > 0)).all():
        raise BadParameter(f"accelerometer variances {variance.tolist()}: give positive numbers, in (m/s^2)^2")
    transverse, known = _find_transverse(geometry)
    free = [term for term in TERMS if term not in known]
    if geometry.fixed_axis:
        free = [*_CENTRE, "omega_x dot", "omega_x^2"]
    wanted = {term: _make_channel(geometry, variance, term, free, known) for term in ("omega_x dot", "omega_x^2")}
    if geometry.fixed_axis and None in wanted.values():
        free = free[len(_CENTRE) :]
        wanted = {term: _make_channel(geometry, variance, term, free, known) for term in wanted}
    omega_dot, omega_squared = wanted.values()
    if omega_dot is None or omega_squared is None:
        raise Unobservable(
            _say_what_lacks(geometry, free, known, [term for term, one in wanted.items() if one is None])
        )

    def make_spares(term: str) -> tuple[Channel | None, ...]:  # one whose noise is infinite has no weight
        """Return for each accelerometer the channel of a term without it, None where the others do not determine it."""
        alone = [np.where(np.arange(k) == lost, np.inf, variance) for lost in range(k)]
        return tuple(_make_channel(geometry, each, term, free, known) for each in alone)

    return SpinChannels(
        geometry=geometry,
        omega_dot=omega_dot,
        omega_squared=omega_squared,
        omega_xy=_make_channel(geometry, variance, "omega_x omega_y", free, known),
        omega_xz=_make_channel(geometry, variance, "omega_x omega_z", free, known),
        spare_dot=make_spares("omega_x dot"),
        spare_squared=make_spares("omega_x^2"),
        transverse=transverse,
        misplaced=find_misplaced(geometry),
    )


def measure(spin: Spin, by: SpinChannels) -> SpinSamples:
    """Return both observations at every sample, and whether each may be used."""
    gyro = np.where(np.isfinite(spin.gyro_radps), spin.gyro_radps, 0.0)
    rates = (gyro[:, None, :] * by.transverse).sum(axis=2)
    return SpinSamples(
        omega_dot_radps2=by.omega_dot.value(spin.accel_mps2, rates),
        omega_squared_radps2=by.omega_squared.value(spin.accel_mps2, rates),
        omega_dot_valid=_find_valid(spin, by, by.omega_dot),
        omega_squared_valid=_find_valid(spin, by, by.omega_squared),
    )


def find_saturated(spin: Spin) -> NDArray[np.bool_]:
    """Return which values (N, k) lie at the range of their accelerometer, where the geometry states it."""
    limits = spin.geometry.accel_range_mps2
    if limits is None:
        return np.zeros(spin.accel_mps2.shape, dtype=np.bool_)
    return np.asarray(np.abs(spin.accel_mps2) >= SATURATED * limits)


def _find_valid(spin: Spin, by: SpinChannels, channel: Channel) -> NDArray[np.bool_]:
    """Return the rows (N,) in which all sensors that the channel uses gave a value within their range."""
    used = channel.accel != 0
    good = np.isfinite(spin.accel_mps2[:, used]).all(axis=1) & ~find_saturated(spin)[:, used].any(axis=1)
    if channel.products.any():
        needed = by.transverse.any(axis=0)
        good &= np.isfinite(spin.gyro_radps[:, needed]).all(axis=1)
    return np.asarray(good)


def _find_transverse(geometry: SpinGeometry) -> tuple[Floats, tuple[str, ...]]:
    """Return weights (2, m) of the gyros for omega_y and omega_z, and which of PRODUCTS they determine."""
    axes = geometry.gyro_axis_b
    if geometry.fixed_axis or not len(axes):
        return np.zeros((2, len(axes))), ()
    inverse = np.linalg.pinv(axes)  # (3, m)
    given = [np.abs(inverse[i] @ axes - np.eye(3)[i]).max() < _NEGLIGIBLE for i in (1, 2)]
    weights = np.where(np.abs(inverse[1:]) > _NEGLIGIBLE, inverse[1:], 0.0) * np.array(given)[:, None]
    known = [term for term, needs in zip(_PRODUCTS, ((0,), (1,), (0, 1)), strict=True) if all(given[i] for i in needs)]
    return weights, tuple(known)


def _make_channel(
    geometry: SpinGeometry, variance: Floats, term: str, free: Sequence[str], known: Sequence[str]
) -> Channel | None:
    """Return the best linear unbiased estimate of a term; None where the accelerometers do not determine it.

    F = X b + K p + noise, with X for the free terms b and K for the known products p: with whitened Xw = D^-1/2 X the
    weights of F are w = D^-1/2 (Xw^+)^T c for b's element c, its variance is |(Xw^+)^T c|^2, those of p are -K^T w.
    """
    seen = coefficients(geometry)
    seen = np.where(np.abs(seen) > _NEGLIGIBLE, seen, 0.0)
    if term not in free:
        return None
    white = seen[:, [TERMS.index(one) for one in free]] / np.sqrt(variance)[:, None]
    inverse = np.linalg.pinv(white, rcond=1e-10)
    row = inverse[free.index(term)]
    if np.abs(row @ white - np.eye(len(free))[free.index(term)]).max() > 1e-6:
        return None
    row = np.where(np.abs(row) > 1e-10 * np.abs(row).max(), row, 0.0)
    accel = row / np.sqrt(variance)
    products = np.array([-(accel @ seen[:, TERMS.index(one)]) if one in known else 0.0 for one in _PRODUCTS])
    return Channel(term, accel, products, float(row @ row))


def _say_what_lacks(geometry: SpinGeometry, free: Sequence[str], known: Sequence[str], terms: Sequence[str]) -> str:
    """Return the sentence of :class:`Unobservable`: what the accelerometers cannot determine, and what to change."""
    seen = np.abs(coefficients(geometry)) > _NEGLIGIBLE
    missing = f"the accelerometers do not fix {' and '.join(terms)}"
    for term in terms:
        if not seen[:, TERMS.index(term)].any():
            where = "radially" if term == "omega_x^2" else "tangentially"
            return f"{missing}: none sees {term}; put one off the axis, {where}"
    if find_misplaced(geometry):
        return f"{missing}: {'; '.join(find_misplaced(geometry))}"
    unknown = [one for one in _PRODUCTS if one in free and seen[:, TERMS.index(one)].any()]
    remedy = "or set fixed_axis for a motor's shaft"
    others = [one for one in free if one not in _PRODUCTS]
    are_enough = all(_make_channel(geometry, np.ones(len(seen)), term, others, _PRODUCTS) for term in terms)
    if unknown and (are_enough or not known):
        lacking = [axis for axis in "yz" if f"omega_{axis}^2" not in known]
        gyros = "gyros about y and z" if len(lacking) == 2 else f"a gyro about {lacking[0]}"
        return f"{missing} apart from {', '.join(unknown)}: add {gyros}, {remedy}"
    return f"{missing} apart from the force at the centre: add accelerometers there, {remedy}"
