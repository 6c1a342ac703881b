"""The servo bench of Byambajav et al."""
