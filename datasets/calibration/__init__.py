"""Calibrations of a sensor: apply one to a recording, keep that of a device, and the Allan deviation of its noise."""
