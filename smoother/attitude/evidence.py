"""Gather what a recording shows before anything is solved: rests, returns, states, start value, field, fixes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.earth import local_declination, local_field_n_ut, normal_gravity_mps2
from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.frames import heading_rotation, quaternion, rotation
from stillpoint.datasets.recording import Floats, Info, Recording, Times
from stillpoint.smoother.attitude.keys import Keys, Motion, choose_keys, prepare_motion
from stillpoint.smoother.attitude.magnetometer import FieldMeasurements, select_measurements, start_field
from stillpoint.smoother.attitude.outside.added import Added, Generator, collect_added
from stillpoint.smoother.attitude.outside.satellite import (
    Fixes,
    align_headings,
    bias_by_satellites,
    drop_rests_under_way,
    path_of_fixes,
    select_fixes,
    start_at_standstill,
)
from stillpoint.smoother.attitude.outside.vehicle import calm_bias, drop_rests_in_curves, vehicle_generators
from stillpoint.smoother.attitude.params import GraphParams, allows_vehicle
from stillpoint.smoother.attitude.returns import Votes
from stillpoint.smoother.attitude.samples.slow_log import RESTORED_SHARE
from stillpoint.smoother.attitude.start import Start, find_start
from stillpoint.smoother.base_pose import BasePose, Returns, find_base_pose, find_returns
from stillpoint.smoother.rest import find_rests
from stillpoint.smoother.strapdown import GyroErrors

_SHORTEST_S = 2.0
_SHORTEST_MOTION_S = 8.0  # without any rest: in 5 s of motion the bias was wrong by more than its covariance said


@dataclass(frozen=True, eq=False)
class Evidence:
    """Everything that the graph is built from, of a whole recording or of one of its windows."""

    motion: Motion
    keys: Keys
    start: Start
    rests_ns: Times
    n_rests_under_way: int  # not used as rests: satellites or a turn show that the body moved
    base: BasePose | None
    returns: Returns | None
    measured: FieldMeasurements | None
    fixes: Fixes | None
    heading: str  # what the heading refers to
    q_nb: Floats  # (n, 4) where the states begin, at the heading that n has
    place_n_m: Floats  # (n, 3)
    velocity_n_mps: Floats  # (n, 3)
    field_start: Floats | None  # (16,) where field, hard iron, delay and matrix of the magnetometer begin
    added: tuple[Added, ...] = ()  # factors of the user and of the vehicle's options, of all states
    restored: bool = False  # a slow log, between whose readings the splines restore the motion

    def within(self, first: int, end: int) -> "Evidence":
        """Return the evidence for the window of the states ``first`` to ``end - 1``."""
        keys = self.keys.within(first, end)
        return replace(
            self,
            keys=keys,
            measured=self.measured and self.measured.at(keys.states),
            fixes=self.fixes and self.fixes.at(keys.states),
        )

    def as_restored(self) -> "Evidence":
        """Return the evidence of a slow log between whose readings the splines restore the motion."""
        motion = replace(self.motion, gyro_sampling_radps=RESTORED_SHARE * self.motion.gyro_sampling_radps)
        keys = replace(self.keys, gyro_sampling_rad=RESTORED_SHARE * self.keys.gyro_sampling_rad)
        return replace(self, motion=motion, keys=keys, restored=True)

    def with_returns(self, returns: Returns | None, params: GraphParams, tested: bool = False) -> "Evidence":
        """Return the evidence with these returns; beside one that is ``tested``, the magnetometer counts less.

        Several returns test each other, and need the magnetometer in full to tell which of them is turned.
        """
        changed = replace(self, returns=returns)
        if self.measured is None:
            return changed
        base, others = changed.return_states()
        rests = (base, *others) if tested and base is not None else ()
        return replace(changed, measured=self.measured.with_returns(rests, params.magnetic))

    def return_states(self) -> tuple[int | None, tuple[int, ...]]:
        """Return the states in the middle of the base rest and of each return in the window."""
        if self.base is None or self.returns is None:
            return None, ()
        middle = [(self.base.start + self.base.end) // 2, *(sum(span) // 2 for span in self.returns.spans)]
        after = np.clip(np.searchsorted(self.keys.row, middle), 1, len(self.keys.row) - 1)
        nearer = np.array(middle) - self.keys.row[after - 1] <= self.keys.row[after] - middle
        base, *returns = (after - nearer).tolist()
        return base, tuple(state for state in returns if state in self.keys.states)

    def find_votes(self) -> Votes | None:
        """Return the rests in the base pose that lie in the window; None where there is none, or no return at all."""
        base, returns = self.return_states()
        if base is None or self.returns is None or not self.returns.spans:
            return None
        states = (*((base,) if base in self.keys.states else ()), *returns)
        return Votes(states, rotation(self.q_nb[base]).as_matrix()[2]) if states else None


def with_free_priors(params: GraphParams, evidence: Evidence) -> GraphParams:
    """Return the settings with wider priors of the gyro's bias and scale if there is no rest.

    Without a rest nothing supports the start value of the bias. Recordings without any rest are of phones and the like,
    whose gyro scales scatter more than those of instruments.
    """
    if len(evidence.rests_ns):
        return params
    p = params.inertial
    wider = replace(
        p,
        gyro_bias_sd_radps=max(p.gyro_bias_sd_radps, p.free_bias_sd_radps),
        gyro_scale_sd=max(p.gyro_scale_sd, p.free_scale_sd),
    )
    return replace(params, inertial=wider)


def turn_start_round(evidence: Evidence) -> Evidence:
    """Return the evidence with its initial heading rotated by 180 deg."""
    turn = heading_rotation(np.pi)
    place, velocity = turn.apply(evidence.place_n_m), turn.apply(evidence.velocity_n_mps)
    q_nb = quaternion(turn * rotation(evidence.q_nb))
    measured = evidence.measured
    field_start = evidence.field_start
    if measured is not None:
        field_start = start_field(measured, q_nb[measured.state], evidence.start.hard_iron_b_ut)
    return replace(evidence, q_nb=q_nb, place_n_m=place, velocity_n_mps=velocity, field_start=field_start)


def gather_evidence(recording: Recording, params: GraphParams, generators: Sequence[Generator] = ()) -> Evidence:
    """Return rests, returns, states, start value, measurements of field and satellites, and added factors.

    Raises :class:`Unobservable` for a recording that is too short to tell bias from motion.
    """
    imu = recording.require_imu()
    seconds = (imu.t_ns[-1] - imu.t_ns[0]) / 1e9
    found_ns = find_rests(imu, params.rest)
    rests_ns = drop_rests_under_way(found_ns, recording.gps)
    if recording.gps is None and allows_vehicle(params):
        rests_ns = drop_rests_in_curves(rests_ns, imu, params.rest.bias_change_radps)
    least_s = _SHORTEST_S if len(rests_ns) else _SHORTEST_MOTION_S
    if seconds < least_s:
        raise Unobservable(
            f"{recording.name}: {seconds:.2f} s are too short to tell bias from motion; give {_SHORTEST_S:.0f} s "
            f"or more with a rest, {_SHORTEST_MOTION_S:.0f} s without"
        )
    motion = prepare_motion(imu, rests_ns)
    keys = choose_keys(motion, params.keys)
    bias = motion.gyro_b_radps[motion.at_rest].mean(axis=0) if motion.at_rest.any() else None
    if bias is None and recording.gps is not None:
        bias = bias_by_satellites(recording.gps, motion, int(imu.t_ns[0]), params.gps)
    elif bias is None and allows_vehicle(params):
        bias = calm_bias(motion.t_s, motion.gyro_b_radps)
    # The start value takes accelerations of a vehicle for turns.
    trusted = bias is not None and (recording.gps is not None or allows_vehicle(params))
    start = find_start(motion, recording.mag, int(imu.t_ns[0]), bias, trusted)
    measured = None
    if recording.mag is not None:
        measured = select_measurements(keys, motion, recording.mag, int(imu.t_ns[0]), params.magnetic)
    fixes = None if recording.gps is None else select_fixes(keys, recording.gps, int(imu.t_ns[0]), params.gps)
    base, returns = _find_base_and_returns(recording, rests_ns, params)
    turn = heading_rotation(_find_start_turn(recording, start, base, measured))
    q_nb = quaternion(turn * rotation(start.q_nb[keys.row]))
    if fixes is not None and measured is None and (recording.base_pose is None or base is None):
        q_nb = align_headings(fixes, motion, start.q_nb, keys)
    field_start = None
    if measured is not None:
        field_start = start_field(measured, q_nb[measured.state], start.hard_iron_b_ut)
    heading = _describe_heading(recording, base, measured, fixes)
    place, velocity = start_at_standstill(keys) if fixes is None else path_of_fixes(fixes, keys)
    gathered = Evidence(
        motion,
        keys,
        start,
        rests_ns,
        len(found_ns) - len(rests_ns),
        base,
        returns,
        measured,
        fixes,
        heading,
        q_nb,
        place,
        velocity,
        field_start,
        collect_added(keys, int(imu.t_ns[0]), recording, [*vehicle_generators(params), *generators]),
    )
    return gathered.with_returns(returns, params)


def _find_base_and_returns(
    recording: Recording, rests_ns: Times, params: GraphParams
) -> tuple[BasePose | None, Returns | None]:
    """Return base pose and returns; None for a recording that does not begin at rest, as the graph needs neither."""
    try:
        base = find_base_pose(recording, rests_ns, params.returns)
    except Unobservable:
        return None, None
    found = find_returns(recording, rests_ns, base, GyroErrors(), params.returns)
    return base, replace(found, swings=())  # attitudes at every sample, which the graph does not need


def _describe_heading(
    recording: Recording, base: BasePose | None, measured: FieldMeasurements | None, fixes: Fixes | None
) -> str:
    """Return what the heading refers to."""
    if recording.base_pose is not None and base is not None:
        return "of the base pose that the recording carries"
    if measured is None and fixes is not None:
        return "true north, from the satellite course"
    if measured is None:
        return "relative to the first attitude: no magnetometer is used"
    return local_declination(recording.info)[1]


def describe_gravity_test(recording: Recording, evidence: Evidence) -> str:
    """Return which data test the sign of gravity.

    Gyro and accelerometer alone do not: with all signs of the accelerometer flipped they fit a world upside down.
    """
    if recording.base_pose is not None and evidence.base is not None:
        return "tested against the base pose"
    if evidence.fixes is not None:
        return "tested against the satellites' velocities"
    there, why = local_field_n_ut(recording.info)
    if evidence.measured is not None and there is not None:
        return "tested against the field's dip at the place"
    if recording.info.date and recording.info.place_lat_lon_alt:
        return f"not tested: {why}"
    return "not tested: an accelerometer with all signs flipped would not show; give place and date, or a base pose"


def has_known_base_pose(recording: Recording, evidence: Evidence) -> bool:
    """Return whether the heading is that of the base pose that the recording carries."""
    return recording.base_pose is not None and evidence.base is not None


def gravity_mps2(info: Info) -> float:
    """Return normal gravity at the place of the recording, or the standard value."""
    if info.place_lat_lon_alt is None:
        return STANDARD_GRAVITY_MPS2
    return normal_gravity_mps2(info.place_lat_lon_alt[0], info.place_lat_lon_alt[2])


def _find_start_turn(
    recording: Recording, start: Start, base: BasePose | None, measured: FieldMeasurements | None
) -> float:
    """Return the angle about up from the start's heading to that of n: of base pose or declination."""
    if recording.base_pose is not None and base is not None:
        known, found = rotation(recording.base_pose), rotation(start.q_nb[base.start])
        difference = quaternion(known * found.inv())
        return float(2 * np.arctan2(difference[3], difference[0]))
    if measured is not None:
        return -local_declination(recording.info)[0]
    return 0.0
