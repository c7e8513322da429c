"""Paths as trajectories: all way points at once, by the gradient of length and clearance."""
