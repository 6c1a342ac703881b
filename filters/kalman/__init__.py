"""Kalman filters of attitude."""
