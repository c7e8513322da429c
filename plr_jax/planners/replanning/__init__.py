"""Paths along lattices made cheaper: robots planned anew among the others, alone or a neighborhood at a time."""
