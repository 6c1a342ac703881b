"""The calibrating factor graph that makes attitude references."""
