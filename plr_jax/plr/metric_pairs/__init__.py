"""Distances of any two points by any metric: a partition of pairs, from samples."""
