"""Conventions in which a truth can be stored, and how well each fits gyro and accelerometer.

A truth can be stored in another convention than is assumed: ``q' = C f(q) B'`` with f the inverse or another order of
the components, C a constant rotation of the world (North-East-Down, y up), and B a constant rotation of the body. A
mirrored ("left-handed") truth has C and B of 180 deg about one axis. B alone is no fault: the IMU is mounted so.

For each f, :class:`TruthFits` finds the rotation between the bodies from the rates (Kabsch). The specific force, turned
into the world of the truth, must then be constant on average, and its direction is where that world has its vertical.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from stillpoint.datasets.doctor.finding import Finding, Remedy
from stillpoint.datasets.doctor.lag import REACH_S, find_lag
from stillpoint.datasets.doctor.truth import FEWEST, average_bins, compute_truth_rates
from stillpoint.datasets.doctor.turning import find_large_sizes, make_gyro_series, make_vector_series
from stillpoint.datasets.doctor.witness import CANDIDATES, MIN_ADVANTAGE, MIN_GAIN, compute_excess, find_index
from stillpoint.datasets.frames import from_xyzw, local_from_enu, quaternion, rotation, to_xyzw
from stillpoint.datasets.recording import Floats, Imu, Truth

_SLOW_WINDOW_S = 0.5
_LEAST_TURN_RAD = np.deg2rad(180.0)  # less turning in all does not show a mismatch
_LEAST_EXPLAINED = 0.3  # share of the turning that truth and gyro have in common
_TURNED_RAD = np.deg2rad(25.0)  # a smaller turn of body or world is an error of mounting or levelling
_UNTURNED = 0.01  # weight of "the bodies are not turned", of the correlation of the rates
_OVERLAP = 2.0  # windows of rates that share data
_FORCE_STEP_S = 0.1
_FORCE_NOISE = 0.15  # of gravity: motion leaves so much beside it
_WORST_FORCE = 0.25  # of gravity: where even the best fit leaves more, translation hides gravity
_NEAR_GRAVITY = 0.1  # only samples whose force is this close to gravity's size say where down is
_FORCE_OVERLAP = 5.0
_FORCE_ADVANTAGE = 0.1
_LEAST_FORCE = 0.5  # of gravity: a mean force that is smaller has no direction
_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])  # of a quaternion wxyz


@dataclass(frozen=True)
class Reading:
    """A way to read the four numbers of a quaternion."""

    name: str  # "" as it is
    words: str  # what it says about the truth
    change: Callable[[Floats], Floats]
    remedies: tuple[Remedy, ...]


_INVERSE = Remedy("conjugate", "truth", "truth: q -> inverse of q")
_FROM_XYZW = Remedy("reorder", "truth", "truth: x, y, z, w -> w, x, y, z")
_TO_XYZW = Remedy("reorder-back", "truth", "truth: components read as x, y, z, w -> w, x, y, z")
_READINGS = (
    Reading("", "", lambda q: q, ()),
    Reading("inverse", "its attitude takes n to the body (it is the inverse)", lambda q: q * _CONJUGATE, (_INVERSE,)),
    Reading("xyzw", "it has its components as x, y, z, w", from_xyzw, (_FROM_XYZW,)),
    Reading("wxyz", "its components were taken for x, y, z, w and are w, x, y, z", to_xyzw, (_TO_XYZW,)),
)


@dataclass(frozen=True, eq=False)
class TruthView:
    """The truth under one reading and one fault of the sensors: how well it fits, and its rotation to the sensors."""

    reading: Reading
    mounting: Rotation  # takes vectors of the IMU's body to the body of the truth
    up_n: Floats  # (3,) direction of the specific force in the world of the truth
    misfit: float  # nats by which it fits worse than the best reading could

    @property
    def mounted(self) -> bool:
        """Return whether the IMU is clearly turned against the body of the truth."""
        return self.mounting.magnitude() > _TURNED_RAD and not self.mirrored

    @cached_property
    def frame(self) -> str | None:
        """Name of the world of the truth where its z does not point up, else None."""
        if self.up_n[2] > np.cos(_TURNED_RAD):
            return None
        if self.up_n[2] < -np.cos(_TURNED_RAD):
            return "left-handed" if self._mirror_axis is not None else "North-East-Down"
        return "y up" if self.up_n[1] > np.cos(_TURNED_RAD) else "turned"

    @property
    def mirrored(self) -> bool:
        """Return whether world and body are both turned by 180 deg about one axis, as by a mirrored axis."""
        return self.frame == "left-handed"

    @property
    def _mirror_axis(self) -> int | None:
        """The axis of a mounting of about 180 deg about x or y; forward-right-down bodies (x) are in a NED world."""
        rotvec = self.mounting.as_rotvec()
        along = np.abs(rotvec) / np.pi
        return 1 if along[1] > 0.9 else None

    @property
    def changes(self) -> int:
        """Return how many conventions of the truth are wrong."""
        return (self.reading.name != "") + (self.frame is not None)

    @property
    def wrong(self) -> bool:
        """Return whether the truth must be changed."""
        return self.changes > 0

    @property
    def words(self) -> str:
        """Return what is wrong with the truth."""
        frame = {
            None: "",
            "North-East-Down": "its world is North-East-Down",
            "left-handed": "it is left-handed (y mirrored)",
            "y up": "its world has y up",
            "turned": "its world is turned",
        }[self.frame]
        return " and ".join(part for part in (self.reading.words, frame) if part)

    def make_world_remedy(self) -> Remedy | None:
        """Return the rotation of the world that makes it East-North-Up as far as gravity shows; None when it is."""
        if self.frame is None:
            return None
        if self.mirrored:
            return Remedy("mirror", "truth", "truth: y mirrored, q -> (w, -x, y, -z)", (1.0,))
        if self.frame == "North-East-Down":
            turn = local_from_enu("ned").inv()
            text = "truth: world North-East-Down -> East-North-Up"
        elif self.frame == "y up":
            turn, text = Rotation.from_euler("x", 90, degrees=True), "truth: world with y up -> z up"
        else:
            turn = _find_smallest_turn(self.up_n, np.array([0.0, 0.0, 1.0]))
            text = f"truth: world turned by {np.rad2deg(turn.magnitude()):.0f} deg so that gravity is vertical"
        return Remedy("world", "truth", text, tuple(float(value) + 0.0 for value in turn.as_matrix().ravel()))

    def remedies(self) -> tuple[Remedy, ...]:
        """Return the remedies of the truth in the order in which they apply."""
        world = self.make_world_remedy()
        return (*self.reading.remedies, *([] if world is None else [world]))

    def correct(self, truth: Truth) -> Truth:
        """Return the truth as it should have been stored, in the body axes of the IMU."""
        q_nb = self.reading.change(truth.q_nb)
        if self.mirrored:
            return replace(truth, q_nb=q_nb * [1.0, -1.0, 1.0, -1.0])
        return turn_truth(replace(truth, q_nb=q_nb), self)

    def findings(self) -> list[Finding]:
        """Return the faults of the truth, and the mounting, which is not a fault."""
        found = []
        for remedy in self.reading.remedies:
            message = (
                f"truth: {self.reading.words}: only then does it turn as the gyro does; {remedy.text.split(': ', 1)[1]}"
            )
            found.append(Finding("truth-quaternion", "error", message, remedy))
        world = self.make_world_remedy()
        if world is not None:
            up = ", ".join(f"{value:+.2f}" for value in self.up_n)
            message = (
                f"truth: gravity points along ({up}) of its world, not along z: "
                f"{replace(self, reading=_READINGS[0]).words}; {world.text.split(': ', 1)[1]}"
            )
            found.append(Finding("truth-world-frame", "error", message, world))
        if self.mounted:
            found.append(self._report_mounting())
        return found

    def _report_mounting(self) -> Finding:
        """Return the fact that the truth's body is turned against the IMU, with angle and axis."""
        rotvec = self.mounting.as_rotvec()
        angle_deg = float(np.rad2deg(np.linalg.norm(rotvec)))
        axis = ", ".join(f"{value:+.2f}" for value in rotvec / np.linalg.norm(rotvec))
        message = (
            f"truth: its body is turned by {angle_deg:.0f} deg about ({axis}) against the IMU, whose sensors agree "
            "among themselves: no fault; score with --align heading+mounting"
        )
        return Finding("mounting", "fact", message, values={"angle_deg": angle_deg})


def turn_truth(truth: Truth, view: TruthView) -> Truth:
    """Return the truth in the body axes of the IMU, for tests that compare it with the sensors axis by axis."""
    if view.mounting.magnitude() < _TURNED_RAD or view.mirrored:
        return truth
    return replace(truth, q_nb=quaternion(rotation(truth.q_nb) * view.mounting))


class TruthFits:
    """How well a truth fits gyro and accelerometer under each reading and fault."""

    def __init__(self, imu: Imu, truth: Truth) -> None:
        """Fit the turning of the truth, in each reading of its columns, to the gyro's."""
        self.origin_ns = int(imu.t_ns[0])
        self.gyro = make_gyro_series(imu, self.origin_ns)
        self.force = make_vector_series(imu.t_ns, imu.accel_b_mps2, self.origin_ns)
        self.lag_s = self._find_lag(truth)
        self.rates = [self._fit_rates(truth, reading) for reading in _READINGS]  # (losses (2, n), rotations (2, 3, 3))
        self.informative = self._is_informative()
        self._forces = [self._compute_forces(truth, reading) for reading in _READINGS] if self.informative else []
        self._tables: dict[tuple[int, int], tuple[Floats, Floats]] = {}
        self._views: dict[tuple[int, int], tuple[TruthView, ...]] = {}

    def _find_spans(self, truth: Truth) -> tuple[Floats, Floats, Floats]:
        """Return start (n,), end (n,) in s and rate (n, 3) of the truth's steps that the gyro covers without a gap."""
        start, end, rate = compute_truth_rates(truth, self.origin_ns)
        inside = (start - REACH_S > self.gyro.t_s[0]) & (end + REACH_S < self.gyro.t_s[-1])
        inside &= ~self.gyro.find_spans_in_gaps(start - REACH_S, end + REACH_S)
        return start[inside], end[inside], rate[inside]

    def _find_lag(self, truth: Truth) -> float:
        """Find the lag by the size of the rates, which no convention changes."""
        start, end, rate = self._find_spans(truth)
        if len(start) < FEWEST:
            return 0.0
        size = np.linalg.norm(rate, axis=1)
        size -= size.mean()
        energy = float(size @ size) + 1e-300

        def compute_loss(lag_s: float) -> Floats:
            """Return the square (n,) of what the truth's turning does not explain of the gyro's at this lag."""
            measured = self.gyro.smooth_between(start + lag_s, end + lag_s) / (end - start)[:, None]
            fast = np.linalg.norm(measured, axis=1)
            fast -= fast.mean()
            return np.asarray((fast - float(size @ fast) / energy * size) ** 2)

        lag = find_lag(compute_loss)
        return lag.lag_s if lag is not None and lag.clear else 0.0

    def _fit_rates(self, truth: Truth, reading: Reading) -> tuple[Floats, Floats, Floats]:
        """Return losses (2, n) of the best rotation and mirrored rotation to the truth, these, and the null's (n,)."""
        start, end, rate = self._find_spans(replace(truth, q_nb=reading.change(truth.q_nb)))
        if len(start) < FEWEST:
            return np.zeros((2, 0)), np.zeros((2, 3, 3)), np.zeros(0)
        measured = self.gyro.smooth_between(start + self.lag_s, end + self.lag_s) / (end - start)[:, None]
        moving = find_large_sizes(np.linalg.norm(rate, axis=1))
        measured, rate = measured[moving], rate[moving]
        turned, target = measured - np.median(measured, axis=0), rate - np.median(rate, axis=0)
        floor = 0.05**2 * float((target**2).sum(axis=1).mean()) + 1e-300
        weight = np.ones(len(turned))
        for _ in range(2):
            correlation = (target * weight[:, None]).T @ turned
            prior = _UNTURNED * np.linalg.norm(correlation) * np.eye(3)  # decides about axes that hardly turn
            u, _, vt = np.linalg.svd(correlation + prior)
            best = u @ vt
            flip = np.diag([1.0, 1.0, -1.0])
            pair = np.array([best, u @ flip @ vt] if np.linalg.det(best) > 0 else [u @ flip @ vt, best])
            residuals = [target - _scale_to_fit(turned @ matrix.T, target) for matrix in pair]
            size = np.linalg.norm(min(residuals, key=lambda r: float((r**2).sum())), axis=1)
            weight = 1 / (1 + (size / (3 * np.median(size) + 1e-300)) ** 2)
        losses = np.array([np.log((one**2).sum(axis=1) + floor) for one in residuals])
        return losses, pair, np.log((target**2).sum(axis=1) + floor)

    def explain_turning(self, truth: Truth) -> tuple[float, float, float]:
        """Return the share of the turning over half seconds that the gyro explains, and how far truth and gyro turn.

        The turns are in rad, summed over the windows of rates; the share is that of the best reading.
        """
        shares, turns = [0.0], (0.0, 0.0)
        for reading in _READINGS:
            start, end, rate = self._find_spans(replace(truth, q_nb=reading.change(truth.q_nb)))
            if len(start) < FEWEST:
                return 0.0, 0.0, 0.0
            measured = self.gyro.smooth_between(start + self.lag_s, end + self.lag_s) / (end - start)[:, None]
            bins = np.floor(start / _SLOW_WINDOW_S).astype(np.int64)
            target, turned = (average_bins(bins, one - np.median(one, axis=0)) for one in (rate, measured))
            u, singular, vt = np.linalg.svd(target.T @ turned)
            common = singular[0] + singular[1] + np.sign(np.linalg.det(u @ vt)) * singular[2]
            shares.append(float(common**2 / (np.sum(target**2) * np.sum(turned**2) + 1e-300)))
            step_s = float(np.median(np.diff(start)))
            sizes = (np.linalg.norm(one - np.median(one, axis=0), axis=1).sum() * step_s for one in (rate, measured))
            turns = tuple(map(float, sizes)) if reading.name == "" else turns  # type: ignore[assignment]
        return max(shares), *turns

    def _is_informative(self) -> bool:
        """Return whether gyro and truth turn together under some reading."""
        return any(len(null) and float((null - losses).mean(axis=1).max()) > MIN_GAIN for losses, _, null in self.rates)

    @cached_property
    def rate_misfit(self) -> Floats:
        """Return (readings, 2) nats by which each fit of the rates is clearly worse than the best."""
        rows = [losses[k] for losses, _, _ in self.rates for k in range(2)]
        if len({len(row) for row in rows}) > 1:  # cannot be: the stamps are the same for all readings
            rows = [row[: min(map(len, rows))] for row in rows]
        table = np.array(rows)
        excess = compute_excess(table, _OVERLAP)
        near = table.mean(axis=1) - table.mean(axis=1).min() < MIN_ADVANTAGE
        return np.where(near, 0.0, excess).reshape(len(_READINGS), 2)

    def _compute_forces(self, truth: Truth, reading: Reading) -> tuple[Floats, Floats]:
        """Return attitudes (m, 3, 3) at calm times about 0.1 s apart, and the specific force (m, 3) in g there."""
        t_s = (truth.t_ns - self.origin_ns) / 1e9
        kept = np.flatnonzero(np.diff(np.floor(t_s / _FORCE_STEP_S), prepend=-1) > 0)
        half = _FORCE_STEP_S / 2
        at_s = t_s[kept] + self.lag_s
        whole = (at_s - half > self.force.t_s[0]) & (at_s + half < self.force.t_s[-1])
        whole &= ~self.force.find_spans_in_gaps(at_s - half, at_s + half)
        kept, at_s = kept[whole], at_s[whole]
        felt = self.force.smooth_between(at_s - half, at_s + half) / _FORCE_STEP_S
        size = np.linalg.norm(felt, axis=1)
        usual = float(np.median(size)) + 1e-300 if len(size) else 1.0
        calm = np.abs(size / usual - 1) < _NEAR_GRAVITY
        return rotation(reading.change(truth.q_nb[kept[calm]])).as_matrix(), felt[calm] / usual

    def _make_force_table(self, place: int, parity: int) -> tuple[Floats, Floats]:
        """Return losses (48, m) of a constant force in the world, and its means (48, 3), per signed permutation."""
        if (place, parity) not in self._tables:
            attitude, felt = self._forces[place]
            if len(felt) < FEWEST:
                self._tables[place, parity] = np.zeros((48, 0)), np.tile([0.0, 0.0, 1.0], (48, 1))
            else:
                to_world = attitude @ self.rates[place][1][parity]
                world = np.einsum("mij,kjl,ml->kmi", to_world, CANDIDATES, felt)
                mean = np.median(world, axis=1)
                off = ((world - mean[:, None]) ** 2).sum(axis=2)
                self._tables[place, parity] = np.log(off + _FORCE_NOISE**2), mean
        return self._tables[place, parity]

    @cached_property
    def force_misfit(self) -> Floats | None:
        """Return (readings, 2, 48) nats by which each constancy of the force is clearly worse than the best.

        None where the force says nothing: too few calm samples, or translation hides gravity.
        """
        tables = [self._make_force_table(place, parity)[0] for place in range(len(_READINGS)) for parity in range(2)]
        rows = np.concatenate(tables)
        if rows.shape[1] == 0 or rows.mean(axis=1).min() > np.log(_FORCE_NOISE**2 + _WORST_FORCE**2):
            return None
        near = rows.mean(axis=1) - rows.mean(axis=1).min() < _FORCE_ADVANTAGE
        excess = compute_excess(rows, _FORCE_OVERLAP)
        return np.where(near, 0.0, excess).reshape(len(_READINGS), 2, 48)

    @cached_property
    def _mountings(self) -> list[list[Rotation]]:
        """The mountings (48) for each wrong gyro, by reading: scipy takes as long for one as for all."""
        parity = (np.linalg.det(CANDIDATES) < 0).astype(np.intp)
        stacks = [Rotation.from_matrix(rotations[parity] @ CANDIDATES) for _, rotations, _ in self.rates]
        return [[stack[k] for k in range(len(CANDIDATES))] for stack in stacks]

    def views(self, gyro: Floats, accel: Floats) -> tuple[TruthView, ...]:
        """Return the view of each reading when gyro and accelerometer measure in these wrong axes (3, 3)."""
        axes = find_index(gyro), find_index(accel)
        if axes not in self._views:  # hypotheses about the magnetometer share them
            self._views[axes] = tuple(self._make_views(gyro, accel))
        return self._views[axes]

    def _make_views(self, gyro: Floats, accel: Floats) -> Iterator[TruthView]:
        """Yield the view of each reading of the truth when gyro and accelerometer measure in wrong axes (3, 3)."""
        parity = 0 if np.linalg.det(gyro) > 0 else 1
        turn = find_index(gyro @ accel.T)  # takes measured forces to the axes of the measured rates
        for place, reading in enumerate(_READINGS):
            mounting = self._mountings[place][find_index(gyro)]
            mean = self._make_force_table(place, parity)[1][turn]
            misfit = float(self.rate_misfit[place, parity])
            up_n = np.array([0.0, 0.0, 1.0])
            if self.force_misfit is not None:
                misfit += float(self.force_misfit[place, parity, turn])
                size = float(np.linalg.norm(mean))
                up_n = mean / size if size > _LEAST_FORCE else up_n
            yield TruthView(reading, mounting, up_n, misfit)


def check_truth_mismatch(fits: TruthFits, truth: Truth, gyro_confirmed: bool) -> list[Finding]:
    """Report a truth that does not turn with the gyro in any reading: of another body, or of another time.

    The truth is dropped only where another sensor confirms the gyro.
    """
    share, truth_rad, gyro_rad = fits.explain_turning(truth)
    if max(truth_rad, gyro_rad) < _LEAST_TURN_RAD or share > _LEAST_EXPLAINED:
        return []
    message = (
        f"truth: turns by {np.rad2deg(truth_rad):.0f} deg in all while the gyro turns by "
        f"{np.rad2deg(gyro_rad):.0f} deg, and only {100 * share:.0f} % of it together: it is of another body, or its "
        "time is wrong"
    )
    values = {"truth_deg": float(np.rad2deg(truth_rad)), "gyro_deg": float(np.rad2deg(gyro_rad)), "explained": share}
    if not gyro_confirmed:
        return [Finding("truth-mismatch", "error", message + "; nothing else tells which is right", None, values)]
    remedy = Remedy("drop-stream", "truth", "truth dropped: it does not belong to this motion")
    return [
        Finding("truth-mismatch", "error", message + "; the other sensors confirm the gyro: drop it", remedy, values)
    ]


def _scale_to_fit(turned: Floats, target: Floats) -> Floats:
    """Return rates scaled to fit the target best."""
    return max(float((turned * target).sum()) / (float((turned**2).sum()) + 1e-300), 0.0) * turned


def _find_smallest_turn(from_n: Floats, to_n: Floats) -> Rotation:
    """Return the smallest rotation that takes one unit vector to another."""
    axis = np.cross(from_n, to_n)
    sine, cosine = float(np.linalg.norm(axis)), float(from_n @ to_n)
    if sine < 1e-9:
        return Rotation.identity() if cosine > 0 else Rotation.from_euler("x", 180, degrees=True)
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, cosine))
