"""Estimators of angle and rate for a body that spins about one axis."""
