"""Sum samples up between states, and interpolate the attitude at every sample from the states."""
