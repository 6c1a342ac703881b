"""The factor graph of a body that spins about one axis."""
