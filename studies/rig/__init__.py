"""Rigs for spinning bodies: where accelerometers sit, and how noisy they are."""
