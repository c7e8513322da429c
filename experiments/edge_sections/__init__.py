"""The sections of ``experiments/edges.py``."""
