"""Distances between any two points of a planar workspace: which corners paths from each cell may turn at first."""
