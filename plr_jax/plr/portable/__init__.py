"""Queries of PLRs without JAX: a reader in NumPy, and generators of C headers and JavaScript modules.

They follow the arithmetic that ``FORMAT.md`` defines and ``arithmetic.py`` implements: results are equal bit for bit.
"""
