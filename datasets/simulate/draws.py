"""Random numbers by name: each part of a simulation has its own generator, so that no option shifts another's draws."""

import numpy as np


def make_generator(seed: int, name: str) -> np.random.Generator:
    """The generator of the part ``name`` (``"gyro/noise"``) in the simulation of that seed."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(name.encode())))
