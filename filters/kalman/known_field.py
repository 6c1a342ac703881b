"""The size and dip of the magnetic field so far, to detect a disturbance by (as in VQF, Laidig and Seel 2023).

The magnetometer is there for the heading, so the heading cannot check it; size and dip of the field can. A disturbance
has three components, of which these two show. If all three are alike, the third, which turns the heading, has the mean
square of the two: :func:`disturbance_variance_ut2`.

A field that resembles the known one is averaged into it, with a memory of ``memory_s``. Another field is a disturbance,
unless it stays the same for ``admission_s`` while the body turns: an object that moves along or stands near does not
look the same from all sides, but another place does. Where the known field is one that the Earth has nowhere, as after
a start beside iron, and the other one is possible, the body need not turn.
"""

from math import atan2, pi, sqrt
from typing import NamedTuple

from stillpoint.datasets.compiled import compiled, compiled_inside
from stillpoint.datasets.plausible import FIELD_RANGE_UT
from stillpoint.filters.rotation import Vector, norm

# Slower than that, and the body does not show whether a field is the same from all sides (20 deg/s).
_TURNING_RADPS = pi / 9
# By which another field follows what is seen of it.
_SHARE_OF_NEWEST = 0.1


class Looks(NamedTuple):
    """Size and dip of a field, and for how long it had them."""

    size_ut: float
    dip_rad: float  # below the horizon
    seen_s: float


class KnownField(NamedTuple):
    """The memory of the field between two windows."""

    known: Looks  # seen_s is 0 before the first field
    other: Looks  # the one that was seen instead, lately
    n_disturbed: int  # means over a window that did not look like the known field
    n_new_fields: int  # how often another field was taken for the known one


class Tolerance(NamedTuple):
    """Constants derived once from the parameters."""

    size: float  # relative
    dip_rad: float
    memory_s: float
    admission_s: float


@compiled
def start_field(zero: float) -> KnownField:
    """Return the record before the first field."""
    nothing = Looks(zero, zero, zero)
    return KnownField(nothing, nothing, 0, 0)


@compiled_inside
def measure_looks(field_n: Vector, seen_s: float) -> Looks:
    """Return size and dip of a field that stood for so long."""
    flat = sqrt(field_n[0] * field_n[0] + field_n[1] * field_n[1])
    return Looks(norm(field_n), atan2(-field_n[2], flat), seen_s)


@compiled_inside
def is_alike(a: Looks, b: Looks, c: Tolerance) -> bool:
    """Return whether ``b`` resembles ``a`` within the tolerance: relative in size, in rad in dip."""
    return abs(b.size_ut - a.size_ut) < c.size * a.size_ut and abs(b.dip_rad - a.dip_rad) < c.dip_rad


@compiled_inside
def is_earthly(a: Looks) -> bool:
    """Return whether the Earth has a field of this size."""
    return a.size_ut > FIELD_RANGE_UT[0] and a.size_ut < FIELD_RANGE_UT[1]


@compiled_inside
def _move_towards(a: Looks, b: Looks, share: float, seen_s: float) -> Looks:
    """Move a by a share of the way to b."""
    return Looks(a.size_ut + share * (b.size_ut - a.size_ut), a.dip_rad + share * (b.dip_rad - a.dip_rad), seen_s)


@compiled_inside
def disturbance_variance_ut2(field: KnownField, seen: Looks) -> float:
    """Return the mean square of one component of a disturbance, by the two that show; 0 before any field is known."""
    known = field.known if field.known.seen_s > 0 else seen
    longer, higher = seen.size_ut - known.size_ut, (seen.dip_rad - known.dip_rad) * known.size_ut
    return (longer * longer + higher * higher) * 0.5


@compiled_inside
def learn_field(field: KnownField, seen: Looks, rate_radps: float, c: Tolerance) -> KnownField:
    """Update the record by the mean field of a window in which the body turned at this rate."""
    known, other, n_disturbed, n_new_fields = field
    if known.seen_s == 0:
        return KnownField(seen, other, n_disturbed, n_new_fields)
    if is_alike(known, seen, c):  # the mean of all at first, of the last memory_s later on
        seen_s = min(known.seen_s + seen.seen_s, max(c.memory_s, seen.seen_s))
        known = _move_towards(known, seen, seen.seen_s / seen_s, seen_s)
        return KnownField(known, Looks(0.0, 0.0, 0.0), n_disturbed, n_new_fields)
    shows = rate_radps > _TURNING_RADPS or (is_earthly(seen) and not is_earthly(known))
    stood_s = seen.seen_s if shows else 0.0
    n_disturbed += 1
    if not is_alike(other, seen, c):
        other = Looks(seen.size_ut, seen.dip_rad, stood_s)
    elif other.seen_s + stood_s < c.admission_s:
        other = _move_towards(other, seen, _SHARE_OF_NEWEST, other.seen_s + stood_s)
    else:
        return KnownField(other, Looks(0.0, 0.0, 0.0), n_disturbed, n_new_fields + 1)
    return KnownField(known, other, n_disturbed, n_new_fields)
