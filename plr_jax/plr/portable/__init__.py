"""Queries of PLRs without JAX: a reader in NumPy, and generators of C headers and JavaScript modules.

``FORMAT.md`` defines all answers, bit for bit. ``arithmetic.py`` holds the steps of a query.
"""
