"""Queries of PLRs without JAX: a reader in NumPy, and generators of C headers and JavaScript modules.

All answers equal, bit for bit, those that ``FORMAT.md`` defines. ``arithmetic.py`` holds the steps of a query.
"""
