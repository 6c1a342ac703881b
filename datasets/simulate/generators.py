"""Give each part of a simulation its own random numbers, so that no option changes the draws of another part."""

import numpy as np


def make_generator(seed: int, name: str) -> np.random.Generator:
    """Return the random generator of the part ``name`` (``"gyro/noise"``) in the simulation with this seed."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(name.encode())))
