"""Lengths of a car's shortest paths, in closed form."""
