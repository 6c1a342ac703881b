"""What tells of the sensor from outside: satellites, a vehicle's wheels, and factors that users add."""
