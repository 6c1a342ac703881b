"""The timings behind ``stillpoint bench NAME``."""
