"""The parts of ``stillpoint archive``."""
