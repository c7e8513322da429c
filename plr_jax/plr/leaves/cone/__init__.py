"""A cone in every leaf: the distance to one source, and on from there."""
