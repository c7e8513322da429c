"""Room 4, optimize: descent along a distance field, and trajectories, by their gradients."""
