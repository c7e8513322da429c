"""Shorter paths for several robots: straight shortcuts, and narrow corridors around a path."""
