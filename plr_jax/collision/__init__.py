"""Collision tests of two robots, or of a robot and obstacles, along straight motions."""
