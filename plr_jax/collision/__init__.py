"""Pairs of robots, and robots and walls, along simultaneous straight motions."""
