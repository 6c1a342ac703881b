"""The stages that every estimator has in front of it: the guard and the source of the heading."""
