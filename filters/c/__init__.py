"""Filters as C99 for microcontrollers, translated from the compiled steps."""
