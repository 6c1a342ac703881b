"""The parts of ``stillpoint stream``: lines in, estimates out."""
