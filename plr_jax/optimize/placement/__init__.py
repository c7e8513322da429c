"""Facility location by the gradients of distances between points: medians and centers in free space."""
