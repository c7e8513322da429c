"""Queries of PLRs without JAX: a reader in NumPy, and generators of C headers and JavaScript modules.

All follow the arithmetic that ``FORMAT.md`` defines and ``arithmetic.py`` implements, so results are equal bit for
bit.
"""
