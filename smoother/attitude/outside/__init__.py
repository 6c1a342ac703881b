"""Sources outside the sensor: satellites, a vehicle's wheels, and factors that users add."""
