"""Cone leaves, functions ``offset + |x - source|``: their model, file format, and search for the best partition."""
