"""Dyadic partitions of a box: cells, the tree over them, their faces and neighbors, and what ties values across."""
