"""From samples to states and back: what was measured between two states, and the attitude at every sample."""
