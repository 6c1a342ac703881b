"""Numbers that several parts of the package need, each defined once."""

STANDARD_GRAVITY_MPS2 = 9.80665
"""The "g" of data sheets and phones (BIPM, SI Brochure): a unit, not the gravity of a place (see ``earth``)."""

MEDIAN_DEVIATION_TO_SD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation: 1 / 0.6745."""
