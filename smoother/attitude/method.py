"""``method="graph"`` as users call it: what stands around the graph.

Islands between gaps are left out, a vehicle without anything that tells its acceleration from gravity is refused, and
satellite fixes whose stamps are late are corrected.
"""

from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np

from stillpoint.datasets.errors import Unobservable
from stillpoint.datasets.recording import Recording
from stillpoint.smoother.attitude.graph import make_attitude_reference
from stillpoint.smoother.attitude.long.kept_windows import KeptWindows
from stillpoint.smoother.attitude.outside.added import Generator, name_generator
from stillpoint.smoother.attitude.params import GraphParams, allows_vehicle
from stillpoint.smoother.attitude.plausibility import find_contradicting_factors
from stillpoint.smoother.long_reference import LongReference
from stillpoint.smoother.stretches import leave_out_islands

_PUNCTUAL_S = 0.1  # a larger delay of the fixes is corrected, unless gps.late_s says what it is


def make_graph_reference(
    recording: Recording,
    params: GraphParams,
    generators: Sequence[Generator] = (),
    kept: KeptWindows | None = None,
) -> LongReference:
    """Return the reference of a recording by the calibrating factor graph, with added factors.

    Of a recording of several windows those that are ``kept`` are not solved again, and others are added to them as
    they are solved; factors that are added are not known by their content, so give none then. Raises
    :class:`Unobservable` as :func:`~stillpoint.smoother.attitude.graph.make_attitude_reference` does.
    """
    if _is_blind_vehicle(recording, params, generators):
        raise Unobservable(
            f"{recording.name}: a vehicle's acceleration cannot be told from gravity without satellites or a "
            "magnetometer; import its fixes, add factors such as a wheel speed, or set motion.nonholonomic"
        )
    whole, islands = leave_out_islands(recording)
    try:
        made = _correct_delay(whole, params, generators, kept)
    except Unobservable as error:
        raise _blame_generator(whole, params, generators, error) from error
    doubtful = find_contradicting_factors(made.facts["diagnostics"]["residuals"])
    found = {"left_out": [asdict(island) for island in islands], "contradicting_factors": doubtful}
    return made.with_diagnostics(found)


def _is_blind_vehicle(recording: Recording, params: GraphParams, generators: Sequence[Generator]) -> bool:
    """Return whether nothing tells the acceleration of a vehicle from gravity."""
    known = recording.gps is not None or recording.mag is not None or params.motion.nonholonomic
    return allows_vehicle(params) and not known and not generators


def _blame_generator(
    recording: Recording, params: GraphParams, generators: Sequence[Generator], error: Unobservable
) -> Unobservable:
    """Return the error that names the added factors without which there is a reference."""
    for one in generators:
        others = [other for other in generators if other is not one]
        if _is_blind_vehicle(recording, params, others):
            continue  # what is left fits anything
        try:
            make_attitude_reference(recording, params, others)
        except Unobservable:
            continue
        found = str(error).removeprefix(f"{recording.name}: ")
        return Unobservable(
            f"{recording.name}: the added factors of {name_generator(one)} contradict the rest, which agrees without "
            f"them; correct their units, signs or noise; with them, {found}"
        )
    return error


def _correct_delay(
    recording: Recording, params: GraphParams, generators: Sequence[Generator], kept: KeptWindows | None
) -> LongReference:
    """Return the reference, made once more with the delay of the fixes that the first one shows if it is large."""
    made = make_attitude_reference(recording, params, generators, kept)
    delay_s = made.facts["diagnostics"].get("fixes", {}).get("delay_s")
    if params.gps.late_s != 0.0 or delay_s is None or abs(delay_s) <= _PUNCTUAL_S:
        return made
    late = replace(params, gps=replace(params.gps, late_s=float(np.clip(delay_s, -2.0, 5.0))))
    again = make_attitude_reference(recording, late, generators, kept)
    left_s = again.facts["diagnostics"]["fixes"]["delay_s"]
    if left_s is None or abs(left_s) >= abs(delay_s):
        return made
    applied = again.facts["diagnostics"]["fixes"] | {"late_s": late.gps.late_s}
    return again.with_diagnostics({"fixes": applied})
