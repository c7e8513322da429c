"""Sections of ``portable.py``."""
