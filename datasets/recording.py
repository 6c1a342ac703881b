"""The data types of a recording of a moving sensor.

Frozen dataclasses of arrays, checked once at construction; nothing later checks them again. Frames: b = sensor body,
n = East-North-Up. Units are SI (field: microtesla) and stand in the names. Every stream has its own clock, ``t_ns``:
int64 nanoseconds, strictly rising, >= 0, either on the Unix epoch or from the source's own zero (``Info.epoch``).
A gyro sample at t_k describes the interval (t_{k-1}, t_k].
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stillpoint.datasets.errors import BadRecording
from stillpoint.datasets.plausible import check_units

Floats = NDArray[np.float64]
Times = NDArray[np.int64]

TRUTHS = ("truth", "roll_truth")  # streams that no sensor gave
_EXTRA_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)
LAST_T_NS = (2**31 - 1) * 1_000_000_000  # a ROS stamp holds int32 seconds


def check_times(owner: str, t_ns: ArrayLike) -> Times:
    """Return rising int64 stamps of shape (N,), N >= 1, or raise :class:`BadRecording`."""
    t = np.asarray(t_ns)
    if t.ndim != 1 or t.dtype.kind not in "iu":
        raise BadRecording(f"{owner}.t_ns: is {t.dtype} of shape {t.shape}; give int64 nanoseconds of shape (N,)")
    if len(t) == 0:
        raise BadRecording(f"{owner}: has no sample; leave the stream out instead")
    if t.min() < 0 or t.max() > LAST_T_NS:  # first: differences of stamps that far apart overflow
        raise BadRecording(f"{owner}: times lie outside 0 .. 2^31 s; shift them so that they start at 0")
    t = t.astype(np.int64, copy=False)
    falls = np.flatnonzero(np.diff(t) <= 0)
    if len(falls):
        k = int(falls[0]) + 1
        raise BadRecording(
            f"{owner}: time does not rise at sample {k} ({(t[k] - t[0]) / 1e9:.6f} s from the start), "
            f"{len(falls)} such in all; sort or drop these samples first"
        )
    return t


def check_floats(owner: str, name: str, values: ArrayLike, shape: tuple[int, ...], finite: bool = True) -> Floats:
    """Return a float64 column of this shape, finite unless its stream allows NaN; raises :class:`BadRecording`."""
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != shape:
        raise BadRecording(f"{owner}.{name}: has shape {array.shape}; give {shape}, as its times ask for")
    if finite and not np.isfinite(array).all():
        rows = np.flatnonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))
        raise BadRecording(
            f"{owner}.{name}: {len(rows)} rows are not finite, the first is {rows[0]}; drop these samples first"
        )
    return array


def check_bools(owner: str, name: str, values: ArrayLike, n: int) -> NDArray[np.bool_]:
    """Return a bool column of the given shape, or raise :class:`BadRecording`."""
    array = np.ascontiguousarray(values)
    if array.shape != (n,) or array.dtype != np.bool_:
        raise BadRecording(f"{owner}.{name}: is {array.dtype} of shape {array.shape}; give bool of shape ({n},)")
    return array


def check_quaternions(owner: str, name: str, values: ArrayLike, shape: tuple[int, ...]) -> Floats:
    """Return finite wxyz columns of length 1 within 1e-6, or raise :class:`BadRecording`."""
    array = check_floats(owner, name, values, shape)
    off = np.abs(np.sqrt(np.einsum("...i,...i", array, array)) - 1.0)  # in a third of the time of np.linalg.norm
    if off.size and off.max() > 1e-6:
        raise BadRecording(
            f"{owner}.{name}: a quaternion is off unit norm by {off.max():.3g} (row {int(off.argmax())}); normalise"
        )
    return array


def freeze(obj: object, **arrays: object) -> None:
    """Put checked arrays into a frozen dataclass, read-only."""
    for name, array in arrays.items():
        if isinstance(array, np.ndarray):
            array = array.view()
            array.flags.writeable = False
        object.__setattr__(obj, name, array)


class _Stamped:
    """Show a stream in one line instead of its arrays."""

    t_ns: Times

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {describe_times(self.t_ns)}>"


@dataclass(frozen=True, eq=False, repr=False)
class Imu(_Stamped):
    """Gyro and accelerometer of one body on one clock, N samples. All rows are finite."""

    t_ns: Times
    gyro_b_radps: Floats  # (N, 3) angular rate over the interval that ends at the stamp
    accel_b_mps2: Floats  # (N, 3) specific force: +g along the axis that points up, at rest

    def __post_init__(self) -> None:
        """Check and freeze the arrays; raises :class:`BadRecording`."""
        t = check_times("imu", self.t_ns)
        gyro = check_floats("imu", "gyro_b_radps", self.gyro_b_radps, (len(t), 3))
        accel = check_floats("imu", "accel_b_mps2", self.accel_b_mps2, (len(t), 3))
        freeze(self, t_ns=t, gyro_b_radps=gyro, accel_b_mps2=accel)


@dataclass(frozen=True, eq=False, repr=False)
class Mag(_Stamped):
    """Magnetometer on its own clock, N samples. All rows are finite."""

    t_ns: Times
    mag_b_ut: Floats  # (N, 3) microtesla

    def __post_init__(self) -> None:
        t = check_times("mag", self.t_ns)
        freeze(self, t_ns=t, mag_b_ut=check_floats("mag", "mag_b_ut", self.mag_b_ut, (len(t), 3)))


@dataclass(frozen=True, eq=False, repr=False)
class Gps(_Stamped):
    """Satellite fixes on their own clock. Rows with ``valid`` False, and altitude, course and speed, may be NaN."""

    t_ns: Times
    lat_deg: Floats  # (N,) geodetic, WGS 84
    lon_deg: Floats  # (N,)
    alt_m: Floats  # (N,) above the ellipsoid
    course_rad: Floats  # (N,) direction of travel, clockwise from true north
    speed_mps: Floats  # (N,) over ground
    valid: NDArray[np.bool_]  # (N,)
    position_sd_m: Floats | None = None  # (N,) horizontal accuracy that the receiver states; NaN where it does not

    def __post_init__(self) -> None:
        """Check and freeze the arrays; raises :class:`BadRecording` for a valid fix without place, or off the globe."""
        t = check_times("gps", self.t_ns)
        if self.position_sd_m is not None:
            stated = check_floats("gps", "position_sd_m", self.position_sd_m, (len(t),), finite=False)
            freeze(self, position_sd_m=np.where(stated > 0, stated, np.nan))
        names = ("lat_deg", "lon_deg", "alt_m", "course_rad", "speed_mps")
        columns = {name: check_floats("gps", name, getattr(self, name), (len(t),), finite=False) for name in names}
        valid = check_bools("gps", "valid", self.valid, len(t))
        where = np.isfinite(columns["lat_deg"]) & np.isfinite(columns["lon_deg"])
        if not where[valid].all():
            raise BadRecording("gps: a valid fix has no latitude or longitude; mark it as not valid")
        if (np.abs(columns["lat_deg"][valid]) > 90).any() or (np.abs(columns["lon_deg"][valid]) > 360).any():
            raise BadRecording("gps: a latitude lies outside +-90 or a longitude outside +-360 deg; check the columns")
        freeze(self, t_ns=t, valid=valid, **columns)


@dataclass(frozen=True, eq=False)
class SpinGeometry:
    """Positions and axes of the k accelerometers and m gyros of a spinning body (Asghari et al. 2018, eq (1)).

    The body spins about its x axis, through the centre of rotation.
    """

    accel_r_b_m: Floats  # (k, 3) lever arms from the centre of rotation; NaN where they are not known
    accel_axis_b: Floats  # (k, 3) unit vectors of the sensitive axes
    gyro_axis_b: Floats  # (m, 3) unit vectors of the sensitive axes
    accel_range_mps2: Floats | None = None  # (k,) the largest size each can give; None where it is not known
    fixed_axis: bool = False  # True: a motor's shaft; the centre is at rest and the body turns about x alone

    def __post_init__(self) -> None:
        """Check and freeze the arrays; raises :class:`BadRecording` for axes that are not of length 1."""
        k, m = len(self.accel_r_b_m), len(self.gyro_axis_b)
        arms = check_floats("spin.geometry", "accel_r_b_m", self.accel_r_b_m, (k, 3), finite=False)
        if np.isinf(arms).any():
            raise BadRecording("spin.geometry.accel_r_b_m: a lever arm is infinite; give NaN where it is not known")
        axes = check_floats("spin.geometry", "accel_axis_b", self.accel_axis_b, (k, 3))
        gyros = check_floats("spin.geometry", "gyro_axis_b", np.reshape(self.gyro_axis_b, (m, 3)), (m, 3))
        for name, vectors in (("accel_axis_b", axes), ("gyro_axis_b", gyros)):
            if len(vectors) and np.abs(np.linalg.norm(vectors, axis=1) - 1).max() > 1e-9:
                raise BadRecording(f"spin.geometry.{name}: an axis is not of length 1; normalise it")
        if self.accel_range_mps2 is not None:
            limits = check_floats("spin.geometry", "accel_range_mps2", self.accel_range_mps2, (k,))
            if (limits <= 0).any():
                raise BadRecording("spin.geometry.accel_range_mps2: a range is not above 0; leave it out if unknown")
            freeze(self, accel_range_mps2=limits)
        freeze(self, accel_r_b_m=arms, accel_axis_b=axes, gyro_axis_b=gyros)


@dataclass(frozen=True, eq=False, repr=False)
class Spin(_Stamped):
    """Single-axis accelerometers and gyros of a fast-spinning body on one clock; NaN where a sensor gave no value."""

    t_ns: Times
    accel_mps2: Floats  # (N, k) one column per accelerometer of the geometry
    gyro_radps: Floats  # (N, m) one column per gyro; m may be 0
    geometry: SpinGeometry

    def __post_init__(self) -> None:
        """Check and freeze the arrays; NaN is a lost value. Raises :class:`BadRecording`."""
        t = check_times("spin", self.t_ns)
        k, m = len(self.geometry.accel_r_b_m), len(self.geometry.gyro_axis_b)
        accel = check_floats("spin", "accel_mps2", self.accel_mps2, (len(t), k), finite=False)
        gyro = check_floats("spin", "gyro_radps", self.gyro_radps, (len(t), m), finite=False)
        if np.isinf(accel).any() or np.isinf(gyro).any():
            raise BadRecording("spin: a value is infinite; give NaN where a sensor gave nothing")
        freeze(self, t_ns=t, accel_mps2=accel, gyro_radps=gyro)


@dataclass(frozen=True, eq=False, repr=False)
class Encoder(_Stamped):
    """Angle and rate about the spin axis on their own clock: of a shaft encoder, or the truth of a simulation."""

    t_ns: Times
    angle_rad: Floats  # (N,) unwrapped
    rate_radps: Floats  # (N,)

    def __post_init__(self) -> None:
        """Check and freeze the arrays; raises :class:`BadRecording`."""
        t = check_times("encoder", self.t_ns)
        angle = check_floats("encoder", "angle_rad", self.angle_rad, (len(t),))
        rate = check_floats("encoder", "rate_radps", self.rate_radps, (len(t),))
        freeze(self, t_ns=t, angle_rad=angle, rate_radps=rate)


@dataclass(frozen=True, eq=False, repr=False)
class Truth(_Stamped):
    """Independent truth (optical, or by construction) on its own clock; a gap is a missing sample, never a NaN row.

    Positions may be NaN where only the attitude is known.
    """

    t_ns: Times
    q_nb: Floats  # (N, 4) wxyz, body to n
    moving: NDArray[np.bool_]  # (N,) the samples that scores count
    position_n_m: Floats | None = None  # (N, 3)

    def __post_init__(self) -> None:
        """Check and freeze the arrays; raises :class:`BadRecording`."""
        t = check_times("truth", self.t_ns)
        q_nb = check_quaternions("truth", "q_nb", self.q_nb, (len(t), 4))
        moving = check_bools("truth", "moving", self.moving, len(t))
        position = self.position_n_m
        if position is not None:
            position = check_floats("truth", "position_n_m", position, (len(t), 3), finite=False)
        freeze(self, t_ns=t, q_nb=q_nb, moving=moving, position_n_m=position)


@dataclass(frozen=True, eq=False, repr=False)
class Series(_Stamped):
    """Any other sensor on its own clock: N rows of k numbers, for factors that users add. Values may be NaN."""

    t_ns: Times
    values: Floats  # (N, k); (N,) is taken as one column
    labels: tuple[str, ...]  # (k,) what each column is, with its unit: "speed_mps"

    def __post_init__(self) -> None:
        """Check and freeze the arrays, (N,) becomes (N, 1); raises :class:`BadRecording`."""
        t = check_times("series", self.t_ns)
        values = np.asarray(self.values, dtype=np.float64)
        values = values[:, None] if values.ndim == 1 else values
        freeze(self, t_ns=t, values=check_floats("series", "values", values, (len(t), len(self.labels)), finite=False))
        object.__setattr__(self, "labels", tuple(self.labels))

    def column(self, label: str) -> Floats:
        """Return the column (N,) of this label; raises :class:`BadRecording` when it is not there."""
        if label not in self.labels:
            raise BadRecording(f"series: has no column {label!r}; it has {', '.join(self.labels)}")
        return self.values[:, self.labels.index(label)]


@dataclass(frozen=True)
class Info:
    """Where a recording comes from and what was done to it; everything here is kept in the MCAP file."""

    source: str = ""  # the dataset, app or simulator
    licence: str = ""
    citation: str = ""
    sensor: str = ""  # model of the device
    epoch: str = "source"  # "unix": t_ns counts from 1970 in UTC; "source": from a zero of the source's own
    date: str = ""  # ISO date (UTC) of the recording, "" when unknown
    place_lat_lon_alt: tuple[float, float, float] | None = None  # deg, deg, m: for declination and gravity
    mag_uncalibrated: bool = False  # True: the field's size has no meaning (hard iron, raw counts)
    units_unchecked: bool = False  # True: sizes were not tested at construction (the doctor opens such files)
    sha256: Mapping[str, str] = field(default_factory=dict)  # of each source file, by its relative name
    conversions: tuple[str, ...] = ()  # "gyro deg/s -> rad/s", one line each
    notes: tuple[str, ...] = ()  # what was dropped, merged or doubtful, with counts
    extra: Mapping[str, str] = field(default_factory=dict)  # facts of the source that have no place above


@dataclass(frozen=True, eq=False)
class Head:
    """Hold the name, the facts and the stream sizes of a recording, which need none of its samples."""

    name: str
    info: Info
    samples: Mapping[str, int]  # of each stream that it has, by the names of :meth:`Recording.streams`
    base_pose: Floats | None = None


@dataclass(frozen=True, eq=False)
class Piece:
    """All samples of a recording in a range of time, or some of its streams; None for a stream without a sample."""

    imu: Imu | None = None
    mag: Mag | None = None
    gps: Gps | None = None
    spin: Spin | None = None
    encoder: Encoder | None = None
    truth: Truth | None = None
    roll_truth: Encoder | None = None
    extra: Mapping[str, Series] = field(default_factory=dict)

    def streams(self) -> Iterator[tuple[str, Times]]:
        """Return the stamps of the streams that have samples, by name."""
        return _list_streams(self)


@dataclass(frozen=True, eq=False)
class Recording:
    """One run of one sensor. Streams keep their own clocks; all clocks of one recording share their zero.

    Raises :class:`BadRecording` when there is neither ``imu`` nor ``spin``, or when sizes are implausible: a still
    stretch whose specific force is far from 9.8 m/s^2, or a field outside 20-70 uT without
    ``info.mag_uncalibrated``.
    """

    name: str
    imu: Imu | None = None
    mag: Mag | None = None
    gps: Gps | None = None
    spin: Spin | None = None
    encoder: Encoder | None = None
    truth: Truth | None = None
    roll_truth: Encoder | None = None  # about the spin axis, exact by construction
    base_pose: Floats | None = None  # (4,) q_nb of the pose in which the sensor rests, when it is known
    info: Info = field(default_factory=Info)
    extra: Mapping[str, Series] = field(default_factory=dict)  # other sensors by name; /extra/NAME in a file

    def __post_init__(self) -> None:
        """Check names, streams and units; raises :class:`BadRecording`."""
        for name in self.extra:
            if not _EXTRA_NAME.fullmatch(name):
                raise BadRecording(f"{self.name}: extra {name!r}: give a name of letters, digits and _")
        if self.imu is None and self.spin is None:
            raise BadRecording(
                f"{self.name}: has neither gyro and accelerometer (imu) nor a spin stream; give one of them"
            )
        if self.base_pose is not None:
            freeze(self, base_pose=check_quaternions(self.name, "base_pose", self.base_pose, (4,)))
        if not self.info.units_unchecked:
            check_units(self)

    @classmethod
    def from_arrays(
        cls,
        name: str,
        t_s: ArrayLike,
        gyro_b_radps: ArrayLike,
        accel_b_mps2: ArrayLike,
        mag_b_ut: ArrayLike | None = None,
        truth_q_nb: ArrayLike | None = None,
        **info: Any,
    ) -> "Recording":
        """Make a recording from arrays on one clock: ``t_s`` (N,) seconds, vectors (N, 3), ``truth_q_nb`` (N, 4) wxyz.

        Rows of ``truth_q_nb`` with NaN become missing samples; every other sample of the truth counts as moving.
        Further keywords are fields of :class:`Info`. Raises :class:`BadRecording`.
        """
        seconds = np.asarray(t_s, dtype=np.float64)
        if seconds.ndim != 1 or not (np.abs(seconds) <= LAST_T_NS / 1e9).all():
            raise BadRecording(f"{name}.t_s: give finite seconds of shape (N,), within 0 .. 2^31 s")
        t_ns = np.round(seconds * 1e9).astype(np.int64)
        mag = None if mag_b_ut is None else Mag(t_ns, np.asarray(mag_b_ut))
        truth = None
        if truth_q_nb is not None:
            q_nb = check_floats(name, "truth_q_nb", truth_q_nb, (len(t_ns), 4), finite=False)
            known = np.isfinite(q_nb).all(axis=1)
            truth = Truth(t_ns[known], q_nb[known], np.ones(int(known.sum()), dtype=np.bool_))
        imu = Imu(t_ns, np.asarray(gyro_b_radps), np.asarray(accel_b_mps2))
        return cls(name, imu=imu, mag=mag, truth=truth, info=Info(**info))

    def __repr__(self) -> str:
        streams = "; ".join(f"{name} {describe_times(t_ns)}" for name, t_ns in self.streams())
        return f"<Recording {self.name}: {streams}>"

    def require_imu(self) -> Imu:
        """Return the IMU stream; raises :class:`BadRecording` when this recording has none."""
        if self.imu is None:
            raise BadRecording(f"{self.name}: has no gyro and accelerometer (imu); this needs them")
        return self.imu

    def streams(self) -> Iterator[tuple[str, Times]]:
        """Return the streams that the recording has, by name."""
        return _list_streams(self)

    @property
    def head(self) -> Head:
        """Return the name, the facts and the stream sizes of the recording."""
        return Head(self.name, self.info, {name: len(t_ns) for name, t_ns in self.streams()}, self.base_pose)

    @property
    def duration_s(self) -> float:
        """Return the time in s from the first sample of any stream but the truths to the last."""
        clocks = [t_ns for name, t_ns in self.streams() if name not in TRUTHS]
        return float(max(t[-1] for t in clocks) - min(t[0] for t in clocks)) / 1e9


def _list_streams(holder: Piece | Recording) -> Iterator[tuple[str, Times]]:
    """Yield name and stamps of each stream that has samples."""
    for name in ("imu", "mag", "gps", "spin", "encoder", *TRUTHS):
        stream = getattr(holder, name)
        if stream is not None:
            yield name, stream.t_ns
    for name, series in holder.extra.items():
        yield f"extra {name}", series.t_ns


def rate_hz(t_ns: Times) -> float:
    """Return samples per second by the median step; 0 for a single sample."""
    return 0.0 if len(t_ns) < 2 else 1e9 / float(np.median(np.diff(t_ns)))


def describe_times(t_ns: Times) -> str:
    """Return number, rate and length of a stream in words."""
    length_s = (int(t_ns[-1]) - int(t_ns[0])) / 1e9
    return f"{len(t_ns)} samples at {rate_hz(t_ns):.4g} Hz, {length_s:.1f} s"
