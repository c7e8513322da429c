"""Cone leaves: model, file format, and search for the best partition."""
